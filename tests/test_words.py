"""Names, keys, datasets, messages and docs use the terms of the field, not words of our own."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]


def words_in(table: str) -> dict[str, str]:
    """Return the words of a table with the terms in their place."""
    return dict(re.findall(r"(\w+):\s+([^;]+)", table))


LEFT = words_in("""
anybody: NO_IDENTITY; belief: inlier_probability; beliefs: inlier probabilities; believed: used;
common_head: merge_metadata; conform: align_to; depth_is_open: depth_ambiguity; doubt: reasons;
doubts: reasons; find_places: forward_kinematics; gross: outlier; gross_chance: outlier_rate;
grossly: outlier; haste: acceleration_scale; laid_onto: aligned; leave_out: omit; left_out:
omitted; misfit: residual_variance; most_held: max_in_memory; obeyed: used; parquet: None;
plausibility: p_value; prior_width: prior_scale; rigged: fit_rig; says_something: is_informative;
steadied: smoothed; straightened: undistorted; surprise: squared_mahalanobis; told_apart:
make_unique; widening: bar_scale
""")
"""Words that the code and its texts no longer use, with the terms in their place."""

LEFT_NAMES = words_in("""
apart: residual, std or distance; asked: used; called: with_prefix; climb: ascent; decompose:
svd_and_prox; expect: require or posterior_mean; factorise_block: cholesky_inverse; foreign:
readers; gone: removed; held: in_memory; hope: predicted_gain; judge: evaluate; judged: evaluated;
kept: retained; near_and_far: depth_ambiguity; nobody: NO_IDENTITY; of_files: restrict_to; pull:
linear_term; recorder: read_poses; room: workspace; said: message; scale_of: fit_scale; seen:
visible or observed; settled: verified; sight: observations; spread: std, subsample or scatter;
steady: smooth; still: tolerance; strange: invalid; stretch: block or bone_scale; told: reported
""")
"""Words that may stand in a sentence, but not in the name of a function, variable or parameter."""

FILLERS = {"each", "found", "known", "own"}
"""Names that say nothing."""

EXEMPT = {"shapefit/io/layout.py"}
"""It lists the names of version 1."""

MOST_PRONOUNS = 25

TEXTS = [
    path
    for pattern in ("shapefit/**/*", "cli/*", "docs/*.md", "configs/**/*.yaml", "README.md")
    for path in sorted(PROJECT.glob(pattern))
    if path.suffix in {".py", ".cpp", ".hpp", ".js", ".css", ".md", ".yaml"}
    if path.relative_to(PROJECT).as_posix() not in EXEMPT
]


def parts_of(name: str) -> set[str]:
    """Return a name in snake_case, without underscores around it, and its words."""
    snake = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower().strip("_")
    return {snake, *snake.split("_")}


def words_of(text: str) -> Iterator[tuple[int, str]]:
    """Yield the words and names of a text with their lines."""
    for number, line in enumerate(text.splitlines(), 1):
        yield from ((number, name) for name in re.findall(r"[A-Za-z_]+", line))


def names_of(text: str) -> Iterator[tuple[int, str]]:
    """Yield the names that a module of Python gives, with their lines."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id


def findings(texts, read, words) -> list[str]:
    return [
        f"{path.relative_to(PROJECT)}:{number}: {word} in {name}"
        for path in texts
        for number, name in read(path.read_text(encoding="utf-8"))
        for word in parts_of(name) & set(words)
    ]


@pytest.mark.parametrize("room", ["shapefit", "cli", "docs", "configs", "README.md"])
def test_words_of_our_own_are_gone(room):
    texts = [path for path in TEXTS if path.relative_to(PROJECT).parts[0] == room]
    assert texts
    assert findings(texts, words_of, LEFT) == []


def test_names_of_our_own_are_gone():
    modules = [path for path in TEXTS if path.suffix == ".py"]
    assert findings(modules, names_of, LEFT_NAMES) == []


def test_names_say_what_a_thing_is():
    modules = [path for path in TEXTS if path.suffix == ".py"]
    assert findings(modules, names_of, FILLERS) == []


def test_docs_name_what_a_pronoun_stands_for():
    pages = [PROJECT / "README.md", *(PROJECT / "docs").glob("*.md")]
    text = "\n".join(page.read_text(encoding="utf-8") for page in pages)
    assert len(re.findall(r"\b(that|those) of\b", text)) <= MOST_PRONOUNS


def test_a_planted_word_is_seen(tmp_path):
    planted = PROJECT / "tests" / "test_words.py"
    assert findings([planted], words_of, {"misfit"})
    source = "def judge_all(seenLandmarks):\n    own = 1\n"
    assert [name for _, name in names_of(source)] == ["judge_all", "seenLandmarks", "own"]
    assert parts_of("seenLandmarks") & LEFT_NAMES.keys() == {"seen"}
