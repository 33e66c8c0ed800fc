"""Commands as a user types them: exit code, what is told, and the output in rounded
numbers.
"""

import csv
import io
import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from tests.cli.conftest import run_in

TABLE = YAML(typ="safe").load(
    Path(__file__).with_name("golden.yaml").read_text(encoding="utf-8")
)
ROWS = [(group, *row) for group, rows in TABLE["commands"].items() for row in rows]


@pytest.fixture(scope="session")
def inputs(project, tmp_path_factory):
    """A folder with sample data, texts of the table, and what the commands of `made`
    write.
    """
    folder = tmp_path_factory.mktemp("golden")
    (folder / "data").symlink_to(project / "sample_data")
    for name, text in TABLE["files"].items():
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "empty.h5").touch()
    (folder / "noise.bin").write_bytes(b"\0\1\2\3")
    (folder / "bad.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    for line in TABLE["made"]:
        done = run_in(folder, *shlex.split(line))
        assert done.returncode == 0, done.stderr
    return folder


def in_numbers(text: str) -> str:
    """Return a table of CSV in one line: its rows, and the mean size of each column of
    numbers.
    """
    rows = list(csv.DictReader(io.StringIO(text)))
    means = []
    for name in rows[0]:
        try:
            values = np.array([float(row[name] or "nan") for row in rows])
        except ValueError:
            continue
        means.append(f"{name} {np.nanmean(np.abs(values)):.3g}")
    return "; ".join([f"{len(rows)} rows", *means])


def pattern(text: str) -> re.Pattern[str]:
    """Return what the text stands for: `...` is anything."""
    return re.compile(
        ".*".join(re.escape(part) for part in text.split("...")), re.DOTALL
    )


@pytest.mark.parametrize(("group", "code", "line", "told", "out"), [
    pytest.param(group, code, line, told, (*out, None)[0], id=f"{group}: {line}")
    for group, code, line, told, *out in ROWS
])  # fmt: skip
def test_a_command(inputs, tmp_path, group, code, line, told, out):
    for path in inputs.iterdir():
        (tmp_path / path.name).symlink_to(path)
    before = sorted(tmp_path.iterdir())
    done = run_in(tmp_path, *shlex.split(line), text=TABLE["files"]["views.csv"])
    assert done.returncode == code, done.stderr
    assert pattern(told).search(done.stderr), done.stderr
    assert code != 2 or (done.stdout, sorted(tmp_path.iterdir())) == ("", before)
    if out is not None:
        written = tmp_path / "o.csv"
        text = written.read_text(encoding="utf-8") if written.exists() else done.stdout
        if not text.startswith("item,landmark,"):
            assert pattern(out).search(text), text
            return
        found, expected = (
            re.findall(r"([\w.]+) ([\w.]+)", each) for each in (in_numbers(text), out)
        )
        assert [name for name, _ in found] == [name for name, _ in expected]
        for (name, value), (_, wanted) in zip(found, expected, strict=True):
            assert name.isdigit() or float(value) == pytest.approx(
                float(wanted), rel=0.01
            ), name
