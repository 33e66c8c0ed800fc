"""No two pages state the same figure of accuracy or speed; and every link of a page resolves."""

import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
PAGES = sorted(
    path.relative_to(PROJECT)
    for pattern in ("*.md", "docs/*.md", "benchmarks/**/*.md", "sample_data/*.md")
    for path in PROJECT.glob(pattern)
)
GENERATED = {"config.md", "commands.md"}
"""Pages made from the code: defaults of keys, no measurements."""

CODE = re.compile(r"^```[\s\S]*?^```|^ {4,}.*$|`[^`\n]*`", re.MULTILINE)
HEADER = re.compile(r"^\|.*\n(?=\|[ :|-]+\|$)", re.MULTILINE)
PAIR = re.compile(r"(?<![\d.])(\d\.\d{2,4})(?: / |\W+\|\W+)(?=(\d\.\d{2,4})(?![\d.]))")
"""Two neighbours in a row or `mean / median`: one decimal may agree by chance, two rarely do."""

RATE = re.compile(r"(?<![\d,.])(\d[\d,]*)(?:/s| \w+ (?:per|a) second)")
LARGE = re.compile(r"(?<![\d,.])(\d{2,3},\d{3}(?:,\d{3})*)(?![\d,.]\d)")


def figures(text: str) -> Iterator[str]:
    """Yield what a page states of errors, as pairs of decimals, and of speed, as large numbers."""
    prose = HEADER.sub("", CODE.sub("", text))
    for left, right in PAIR.findall(prose):
        yield f"{left}, {right}"
    for rate in RATE.findall(prose):
        yield f"{rate}/s"
    for number in LARGE.findall(prose):
        if not number.endswith(",000"):
            yield number


def stated_twice(pages: dict[str, str]) -> dict[str, set[str]]:
    """Return the figures that stand on more than one page, and these pages."""
    places = defaultdict(set)
    for name, text in pages.items():
        for figure in figures(text):
            places[figure].add(name)
    return {figure: names for figure, names in places.items() if len(names) > 1}


def test_no_two_pages_state_the_same_figure():
    pages = {
        str(page): (PROJECT / page).read_text(encoding="utf-8")
        for page in PAGES
        if page.name not in GENERATED
    }
    assert stated_twice(pages) == {}


STATED = (
    "| subject 13 | 0.288 | 0.275 |",
    "an error of 0.071 / 0.066",
    "it solves 27,200 images per second",
    "| case | 62,246/s |",
    "| gap 1e-4, 1 thread | 62,246 |",
)


def test_a_figure_stated_twice_is_found():
    for text in STATED:
        assert stated_twice({"README.md": text, "docs/method.md": f"Measured: {text}"}), text


def anchors(text: str) -> set[str]:
    """Return the anchors of the headings of a page, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def broken_links(page: Path) -> Iterator[str]:
    """Yield the links of a page whose file or heading is not there."""
    text = CODE.sub("", (PROJECT / page).read_text(encoding="utf-8"))
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        target, _, anchor = link.partition("#")
        path = (PROJECT / page).parent / target if target else PROJECT / page
        if "://" in target:
            continue
        if not path.exists() or (anchor and anchor not in anchors(path.read_text("utf-8"))):
            yield f"{page} links to {link}"


def test_links_resolve():
    broken = [link for page in PAGES for link in broken_links(page)]
    assert not broken, "\n".join(broken)


def test_guides_guide():
    """What was tried, and how numbers were chosen, is in `benchmarks/notes`."""
    pages = [page for page in PAGES if page.parts[0] == "docs" and page.name not in GENERATED]
    words = {page.name: len((PROJECT / page).read_text("utf-8").split()) for page in pages}
    assert sum(words.values()) <= 20_000, words


def test_the_index_reaches_every_page():
    index = (PROJECT / "docs/README.md").read_text(encoding="utf-8")
    linked = set(re.findall(r"\]\(([\w.]+\.md)", index))
    assert {path.name for path in (PROJECT / "docs").glob("*.md")} - {"README.md"} == linked
