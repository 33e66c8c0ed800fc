"""The examples of a page run one after the other and print what it says."""

import contextlib
import io
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

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
                done = subprocess.run(command, capture_output=True, text=True, check=False)
                assert done.returncode == 0, done.stderr
        else:
            assert printed == text
            printed = None
