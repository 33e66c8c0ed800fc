"""The texts that people read stay free of phrases that an editor has corrected once.

Pages, comments and messages are read: Markdown, Python (strings, docstrings, comments), the C++
of the core, the page's HTML and scripts, configs and the Makefile.
"""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]

COUNTED = (
    "one|ones|numbers?|seconds|milliseconds|microseconds|ms|us|MB|KB|bytes|status|Status|certificate"
    "|rotations?|rows?|columns?|lines?|cells?|files?|folders?|one name|matrix|matrices|masks?|sets?"
    "|transforms?|terms?|products?|solves?|solvers?|steps?|draws?|poses?|pictures?|tables?|boxe?s?"
    "|bars?|plots?|points?|[Oo]utcomes?|arrays?|text|body|bodies|mesh|meshes|threads?|trials?|images?|frames?|shapes?|landmarks?|atoms?|items?"
    "|pairs?|copy|copies|classes|tests?|functions?|keys?|values?|records?|requests?|dictionary"
    "|dictionaries|objects?|rounds?|turns?|times|vectors?|entry|entries|digits?|calls?|spaces?"
)
UNITS = (
    "image|item|atom|landmark|sequence|group|method|metric|row|column|line|cell|file|folder|frame"
    "|second|minute|thread|trial|shape|value|edge|command|car|class|subject|body|case|record|object"
    "|coordinate|chunk|block|stretch|level|name|kind|page|face|vertex|bone|format"
)

TICS = {
    "`report`, `state` or `show` for `tell`": r"\b(tells?|told|telling)\b(?! (\w+ ){0,4}apart\b)",
    "`is ignored`, `influences` for `has a say`": (
        r"\b(have|has|had|having) (a |no |any )?say\b|\bsay in\b"
    ),
    "`per image` for `an image`": (
        rf"(?<!every )(?<!each )(?<!training )\b({COUNTED}) an? ({UNITS})\b"
        r"(?! (of|that|which|whose|to|is|at a time)\b)"
    ),
}

PASSAGES = (
    r"\bmade sample data\b",
    r"that other work shares?|that others share",
    r"half of the error on sequences",
    r"lambda has no say",
    r"nothing that the solver believes",
    r"had a say in how the others were turned",
    r"may tell about each other",
    r"done better to answer the mean shape",
    r"a mesh mixed so shears|it is no car any more",
    r"stands on its head|turned half about",
    r"\bare no surprise\b",
    r"that must be wrong are told",
    r"\bmost (rounds|pictures|iterations|steps)\b(?=.{0,20}\b(for one|; the|of coding|\.))",
    r"\b(is|each|not|as|or) a text\b",
    r"or run them apart",
    r"asks? for what\b",
    r"\bhuman text\b",
    r"the shape found is not finite",
)


def markdown() -> Iterator[Path]:
    """Yield the pages; the notes of benchmarks too."""
    for pattern in ("*.md", "docs/*.md", "benchmarks/**/*.md", "sample_data/*.md"):
        yield from PROJECT.glob(pattern)


def sources() -> Iterator[Path]:
    """Yield the sources whose texts are read."""
    for folder in ("shapefit", "cli", "benchmarks", "building", "sample_data", "docs"):
        yield from (PROJECT / folder).rglob("*.py")


def marked() -> Iterator[Path]:
    """Yield the other files that hold text: kernels, the page, configs, the Makefile."""
    for pattern in (
        "shapefit/core/**/*.?pp",
        "shapefit/viewer/**/*.js",
        "shapefit/viewer/**/*.html",
    ):
        yield from PROJECT.glob(pattern)
    yield from (PROJECT / "configs").rglob("*.yaml")
    yield PROJECT / "Makefile"


def python_texts(source: str) -> Iterator[str]:
    """Yield the strings (joined where they are adjacent), docstrings and blocks of comments."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.JoinedStr):
            yield "".join(
                part.value if isinstance(part, ast.Constant) else "0" for part in node.values
            )
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value
    comments: list[str] = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            comments.append(token.string.lstrip("# "))
        elif token.type != tokenize.NL and comments:
            yield " ".join(comments)
            comments = []


def marked_texts(source: str) -> Iterator[str]:
    """Yield the text of a file with comments, their marks and ids taken out; other code stays."""
    yield re.sub(
        r"^\s*(//|#|\*|/\*\*?)|\btell(Soon)?\b(?=[(.,])|\bid=\"\w+\"", " ", source, flags=re.M
    )


def found(text: str) -> list[str]:
    """Return the phrases of a text that are to be written otherwise."""
    plain = re.sub(r"\s+", " ", text)
    hits = [
        f"{advice}: ...{plain[max(0, hit.start() - 30) : hit.end() + 30]}..."
        for advice, pattern in TICS.items()
        for hit in re.finditer(pattern, plain)
    ]
    return hits + [hit[0] for p in PASSAGES for hit in re.finditer(p, plain, re.IGNORECASE)]


def report(path: Path) -> list[str]:
    """Return what is to be written otherwise in a file."""
    source = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        texts = python_texts(source)
    else:
        texts = [source] if path.suffix == ".md" else marked_texts(source)
    return [hit for text in texts for hit in found(text)]


FILES = sorted({*markdown(), *sources(), *marked()})


def test_texts_are_plain():
    hits = [f"{path.relative_to(PROJECT)}: {hit}" for path in FILES for hit in report(path)]
    assert not hits, "\n".join(hits)


OLD = (
    "*Made sample data.*",
    "on 2 cores of an AMD EPYC that other work shares",
    "half of the error on sequences",
    "lambda has no say",
    "nothing that the solver believes\nenters",
    "the model has had a say in how\n  the others were turned",
    "the frames of a sequence may tell about each other",
    "would have done better to answer the mean shape",
    "A mesh mixed so shears",
    "stands on its head in most programs",
    "a closed or full standard stream are no surprise",
    "principal points that must be wrong are told",
    "Most rounds for one image.",
    "Most pictures; the first items that fit count.",
    "a list, each a text",
    "give files that agree, or run them apart",
    "asks for what a.csv cannot hold",
    "Human text goes to stderr",
    "the shape found is not finite",
    "All are one number an image.",
    "milliseconds an image",
    "tens of\nthousands of images a second",
    "one rotation an image or one an atom",
    "What the images of one sequence tell about each other.",
    "a dataset which tells how large its atoms are",
)


PLAIN = (
    "one number per image",
    "It needs an image, and a landmark that is visible.",
    "Colours that are told apart with every form of colour blindness.",
    "Give every atom a rotation.",
    "the rotation of an image",
    "the result reports the gap",
)


def test_an_old_phrase_is_found():
    assert [text for text in OLD if not found(text)] == []
    assert [text for text in PLAIN if found(text)] == []
