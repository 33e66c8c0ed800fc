"""The commands of the README run, in their order, on a copy of what they read."""

import os
import re
import shlex
import subprocess
from pathlib import Path

import pytest


@pytest.mark.slow
def test_a_clone_does_what_the_readme_says(project: Path, readme_commands: list[str], tmp_path):
    """Only the commands of the README, in their order, from the clone on.

    What this runs in is `make test-all`: of `make test` it asks whether there is such a target.
    `pip` installs once more what `make demo` has.
    """
    clone, printed = tmp_path / "shapefit", ""
    path = f"{clone}/.venv/bin{os.pathsep}{os.environ['PATH']}"
    for command in readme_commands:
        command = command.replace("make test", "make -n test")
        if command.startswith("git clone"):
            command = f"git clone --quiet {shlex.quote(str(project))} shapefit"
        elif command.startswith("pip "):
            assert (clone / ".venv/bin/shapefit").is_file()
            continue
        done = subprocess.run(
            shlex.split(command),
            cwd=clone if clone.exists() else tmp_path,
            env={**os.environ, "PATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, f"{command}\n{done.stderr}"
        printed += "" if command.startswith("make ") else done.stdout
    assert printed.startswith("item,landmark,x,y,z\n")
    check_sample(project, printed)
    assert (clone / "shapes.csv").read_text(encoding="utf-8").count("\n") > 12 * 15
    assert len(list((clone / "meshes").rglob("*.glb"))) == 108
    assert (clone / "sheet.png").is_file()
    assert (clone / "results/demo/walk.html").is_file()


def check_sample(project: Path, printed: str) -> None:
    """Fail unless the two tables of the README are lines of the input and of what is printed."""
    text = (project / "README.md").read_text(encoding="utf-8")
    (sample,) = re.findall(r"```\n(item,landmark,x,y .*?)```", text, re.DOTALL)
    shown = [line.split() for line in sample.splitlines()]
    assert len(shown) == 4
    assert shown[-1] == ["...", "..."]
    lines = (project / "sample_data/one_person.csv").read_text(encoding="utf-8").splitlines()
    for (line_in, line_out), line, fitted in zip(shown, lines, printed.splitlines(), strict=False):
        if line_in == "...":
            continue
        assert line == line_in
        *names, x, y, z = fitted.split(",")
        if x != "x":  # the README shows two digits, an image of pixels needs no more
            x, y, z = (f"{float(number):.2f}" for number in (x, y, z))
        assert line_out == ",".join([*names, x, y, z])
