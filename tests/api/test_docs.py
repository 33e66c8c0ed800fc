"""The examples of a page run one after the other and print what it says."""

import contextlib
import io
import re
import shlex
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

import shapefit
from tests.cli.conftest import run_in

BLOCK = re.compile(r"```(python|console|)\n(.*?)```", re.DOTALL)


PAGES = {"python": 9, "from_matlab": 4}
"""Pages of docs/, and how many examples there are at least."""


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("page", PAGES)
def test_the_examples_print_what_the_page_says(project, tmp_path, monkeypatch, page):
    (tmp_path / "sample_data").symlink_to(project / "sample_data")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    printed = None
    blocks = BLOCK.findall((project / f"docs/{page}.md").read_text(encoding="utf-8"))
    assert len([kind for kind, _ in blocks if kind == "python"]) >= PAGES[page]
    for kind, text in blocks:
        if kind == "python":
            assert not printed, f"the page does not show {printed!r}"
            with contextlib.redirect_stdout(io.StringIO()) as shown:
                exec(compile(text, f"docs/{page}.md", "exec"), names)
            printed = shown.getvalue()
        elif kind == "console":
            for line in text.splitlines():
                command = shlex.split(line.removeprefix("$ "))
                command[0] = str(Path(sys.executable).with_name(command[0]))
                done = subprocess.run(
                    command, capture_output=True, text=True, check=False
                )
                assert done.returncode == 0, done.stderr
        else:
            assert printed == text
            printed = None


@pytest.mark.slow
def test_the_examples_that_need_other_libraries_or_files_run(
    project, tmp_path, monkeypatch
):
    """cvxpy finds the optimum of the page; pandas writes landmarks; a loop is an
    experiment.
    """

    def run_block(page: str, after: str, names: dict[str, object]) -> str:
        text = (
            (project / f"docs/{page}.md")
            .read_text(encoding="utf-8")
            .partition(after)[2]
        )
        found = re.search(r"```python\n((?s:.*?))```|\n\n((?: {4}.*\n|\n)+)", text)
        block = found[1] or found[2]
        with contextlib.redirect_stdout(io.StringIO()) as shown:
            exec(compile(textwrap.dedent(block), f"docs/{page}.md", "exec"), names)
        return shown.getvalue()

    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"np": np, "shapefit": shapefit}
    run_block("python", "## The convex program alone", names)
    assert run_block("python", "The same with cvxpy", names) == "True\n"
    for name, file in (("train", "people_train.h5"), ("test", "people_test.h5")):
        (tmp_path / f"{name}.h5").symlink_to(project / "sample_data" / file)
    assert run_in(tmp_path, "project", "test.h5", "-o", "views.h5").returncode == 0
    errors = run_block("experiments", "## Your own experiment", {}).splitlines()
    assert [line.split()[0] for line in errors] == ["0.05", "0.1", "0.2"]
