"""Build the site: gather the pages, add the functions and a live result, build, check
the links.

`python tools/site.py` (`make site`) writes build/site/html, with the settings of
mkdocs.yml. The pages keep their places, so that a link leads to the same page here and
there.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import shapefit
from shapefit.api import arguments
from shapefit.api.files import Reading
from shapefit.records.page import Page

PROJECT = Path(__file__).resolve().parents[1]
PAGES = PROJECT / "build/site/pages"

GATHERED = (
    "*.md",
    "CITATION.cff",
    "docs/*.md",
    "docs/gallery/*",
    "docs/images/**/*.*",
    "benchmarks/*.md",
    "benchmarks/*.toml",
    "benchmarks/notes/*.md",
)


def main() -> None:
    """Write the site; end with exit code 1 where it cannot be built, as with a link
    that leads nowhere.
    """
    shutil.rmtree(PAGES.parent, ignore_errors=True)
    for pattern in GATHERED:
        for path in PROJECT.glob(pattern):
            place = PAGES / path.relative_to(PROJECT)
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, place)
    for path in PAGES.glob(
        "benchmarks/**/*.md"
    ):  # for developers: linked to, not searched
        text = path.read_text(encoding="utf-8")
        path.write_text(
            f"---\nsearch:\n  exclude: true\n---\n\n{text}", encoding="utf-8"
        )
    for path in PROJECT.glob("docs/gallery/*.ipynb"):
        run_notebook(path, PAGES / path.relative_to(PROJECT))
    (PAGES / "docs/api.md").write_text(functions_page(), encoding="utf-8")
    write_sample(PAGES / "sample.html")
    build = [
        sys.executable,
        "-m",
        "mkdocs",
        "build",
        "--strict",
    ]  # --quiet would let bad links pass
    done = subprocess.run(build, cwd=PROJECT, stderr=subprocess.PIPE, text=True)
    wrong = [
        line
        for line in done.stderr.splitlines()
        if line.startswith(("WARNING", "ERROR"))
    ]
    sys.exit("\n".join(wrong or [done.stderr]) if done.returncode else None)


def run_notebook(source: Path, target: Path) -> None:
    """Run a notebook in its folder, and write it with its outputs to `target`.

    An exception of a cell ends the build.
    """
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(source, as_version=4)
    place = {"metadata": {"path": str(source.parent)}}
    NotebookClient(notebook, timeout=600, resources=place).execute()
    nbformat.write(notebook, target)


SECTIONS = (arguments.Camera, arguments.Prior, arguments.Save, arguments.LearnedPrior)
"""Mappings that arguments of functions are."""


def functions_page() -> str:
    """Return the page, in Markdown, of all functions and classes of `import shapefit`,
    which mkdocs fills from their docstrings.
    """
    names = [name for name in shapefit.__all__ if not name.startswith("_")]
    places = [*(getattr(shapefit, name) for name in names), Page, *SECTIONS, Reading]
    return "# Functions\n\n" + "\n".join(
        f"::: {place.__module__}.{place.__qualname__}\n" for place in places
    )


def write_sample(page: Path) -> None:
    """Lift the two walkers of sample_data and write the page of the result."""
    command = [sys.executable, "-m", "shapefit"]
    with tempfile.TemporaryDirectory() as folder:
        result = str(Path(folder) / "walk.h5")
        given = ["sample_data/openpose", "-d", "people", "--set", "keypoints=body_25"]
        rate = ["--set", "frame_rate=25"]
        for arguments in (
            ["fit", *given, *rate, "-o", result],
            ["view", result, "-o", str(page)],
        ):
            subprocess.run([*command, *arguments, "-q"], cwd=PROJECT, check=True)


if __name__ == "__main__":
    main()
