"""What a shell offers: asked of the command itself, and typed into a real bash."""

import os
import pty
import re
import select
import shutil
import subprocess
import sys
import time

import pytest

BASH = shutil.which("bash")


def complete(words: str, kind: str = "bash_complete") -> list[str]:
    """Return what a shell is offered for the last of the words, after a blank "" ."""
    last = str(len(words.split(" ")) - 1)
    asked = {"_SHAPEFIT_COMPLETE": kind, "COMP_WORDS": words, "COMP_CWORD": last}
    line = [sys.executable, "-m", "shapefit"]
    done = subprocess.run(
        line, env=os.environ | asked, capture_output=True, text=True, check=True
    )
    return [line for line in done.stdout.splitlines() if line]


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("shapefit learn", ["plain,learn-dict"]),
        ("shapefit fit --key", ["plain,--keypoints"]),
        ("shapefit fit wal", ["file,wal"]),
        ("shapefit fit -o ", ["file,"]),
        ("shapefit fit --calibration c", ["file,c"]),
        ("shapefit fit -d p", ["plain,people", "file,p"]),
        ("shapefit view -d ", ["plain,people", "file,"]),
        ("shapefit fit -c ca", ["plain,cars", "file,ca"]),
        ("shapefit fit --method convex", ["plain,convex", "plain,convex+refine"]),
        ("shapefit learn-dict --method p", ["plain,pca-bases"]),
        ("shapefit fit --focal ", ["plain,auto", "plain,none", "plain,files"]),
        ("shapefit fit --lambda a", ["plain,auto"]),
        ("shapefit fit --keypoints coco_1", [f"plain,coco_{n}" for n in (17, 18, 133)]),
        ("shapefit fit --keypoints n", ["plain,numbered"]),
        ("shapefit convert --to p", ["plain,ply"]),
        ("shapefit info --format slea", ["plain,sleap-analysis-h5", "plain,sleap-slp"]),
        ("shapefit eval --match ", ["plain,item", "plain,frame"]),
        (
            "shapefit fit --set camera.f",
            ["plain,camera.focal=", "plain,camera.focal_sd="],
        ),
        ("shapefit fit --set markers = i", ["plain,input"]),
        ("shapefit fit --markers = i", ["plain,input"]),
        ("shapefit config fit camera.n", ["plain,camera.name"]),
        ("shapefit fit --individual a", []),
    ],
)
def test_what_is_offered(words, offered):
    assert sorted(complete(words)) == sorted(offered)


def test_other_shells_have_the_scripts_of_click():
    assert "#compdef shapefit" in complete("shapefit", "zsh_source")
    assert any("fish_complete" in line for line in complete("shapefit", "fish_source"))


class Shell:
    """A bash at a terminal, in a folder, in which completion is switched on."""

    def __init__(self, folder, script):
        command = folder / "bin/shapefit"
        command.parent.mkdir()
        command.write_text(f'#!/bin/sh\nexec {sys.executable} -m shapefit "$@"\n')
        command.chmod(0o755)
        settings = {"PS1": "> ", "TERM": "dumb", "HOME": str(folder), "COLUMNS": "200"}
        settings["PATH"] = f"{command.parent}:{os.environ['PATH']}"
        pid, self.terminal = pty.fork()
        if pid == 0:
            os.chdir(folder)
            os.execve(BASH, ["bash", "--norc", "-i"], os.environ | settings)
        self.pid = pid
        self.type("bind 'set bell-style none'; bind 'set page-completions off'\n")
        self.type(f"source {script}\n")

    def type(self, text: str, until: str = r"> $", seconds: float = 20) -> str:
        """Type a text; return what the terminal then shows, until a pattern."""
        os.write(self.terminal, text.encode())
        shown, end = "", time.monotonic() + seconds
        while not re.search(until, shown) and time.monotonic() < end:
            if select.select([self.terminal], [], [], 0.1)[0]:
                shown += os.read(self.terminal, 4096).decode()
        return shown

    def finish(self, line: str, until: str) -> str:
        """Type a line and the key Tab; return the line that bash makes of it."""
        shown = self.type(f"{line}\t", until)
        self.type("\x15\n")  # erases the line
        return shown.replace("\a", "")


@pytest.fixture(scope="module")
def bash(tmp_path_factory):
    if BASH is None:
        pytest.skip("there is no bash")
    folder = tmp_path_factory.mktemp("bash")
    for name in ("walk.json", "people_of_mine.h5", "my shapes.csv", "conv.txt"):
        (folder / name).touch()
    (folder / "cam01").mkdir()
    script = folder / "completion.sh"
    script.write_text("\n".join(complete("shapefit", "bash_source")))
    shell = Shell(folder, script)
    yield shell
    os.close(shell.terminal)
    os.waitpid(shell.pid, 0)


@pytest.mark.parametrize(
    ("typed", "finished"),
    [
        ("shapefit learn", "shapefit learn-dict "),
        ("shapefit fit my", r"shapefit fit my\ shapes.csv "),
        ("shapefit fit 'my", "shapefit fit 'my shapes.csv' "),
        ("shapefit fit ~/wa", "shapefit fit ~/walk.json "),
        ("shapefit fit x -d peopl", "shapefit fit x -d people"),
        ("shapefit fit x --method seq", "shapefit fit x --method sequences "),
        ("shapefit fit x --method=seq", "shapefit fit x --method=sequences "),
        ("shapefit fit x --set camera.n", "shapefit fit x --set camera.name="),
        ("shapefit fit x --set method=seq", "shapefit fit x --set method=sequences "),
        ("shapefit fit x --output=wa", "shapefit fit x --output=walk.json "),
    ],
)
def test_bash_finishes_a_line(bash, typed, finished):
    shown = bash.finish(typed, re.escape(finished))
    assert shown.endswith(finished)


def test_bash_offers_no_file_as_a_method(bash):
    assert "conv.txt" not in bash.finish("shapefit fit x --method conv\t", "refine")
