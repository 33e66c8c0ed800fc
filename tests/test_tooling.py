"""`make bench`, `make mutants` and `make fuzz`: what makes them fail, and short runs of
them.
"""

import ast
import subprocess
import sys
from importlib import import_module

import pytest

from benchmarks.bench import Table
from benchmarks.cases import Row
from tests.fuzz.kinds import FINDINGS, KINDS

CASES = 165
"""Of each kind in `make test-all`; `make test` has those that once failed."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_many_spoiled_inputs(project, kind):
    python(project, "tests.fuzz", "--jobs", "1", "--kinds", kind, "--cases", str(CASES))


def test_what_once_failed_stays_mended(project):
    assert int(python(project, "tests.fuzz", "--past").split()[0]) == len(FINDINGS)


def test_outputs_are_old_or_new_whichever_call_fails(project):
    python(project, "tests.fuzz.faults", "--quick", "--commands", "fit to CSV")


@pytest.mark.slow
def test_outputs_of_all_commands_are_old_or_new_whichever_call_fails(project):
    python(project, "tests.fuzz.faults", "--quick")


def python(project, module, *arguments):
    """Run a module, which must succeed, and return what it prints."""
    command = [sys.executable, "-m", module, *arguments]
    done = subprocess.run(
        command, cwd=project, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def script(project):
    sys.path.append(str(project / "tools"))
    return import_module("mutants")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a < b", {"a > b"}),
        ("a and b", {"a or b", "a"}),
        ("np.sqrt(a - b)", {"a - b", "a + b", "a"}),
        ("f(a, b, k=c)", {"f(b, a, k=c)", "f(a, b)"}),
        ("'é' + str(1)", {"2"}),
        ("raise E(1)", set()),
        ("if a:\n    return", {"not a", "False"}),
    ],
)
def test_every_kind_of_change_is_made_and_messages_are_left(
    script, tmp_path, text, expected
):
    path = tmp_path / "source.py"
    body = f"def f():\n    'é'\n    {text.replace(chr(10), chr(10) + '    ')}\n"
    path.write_text(body, encoding="utf-8")
    mutants = list(script.mutants(path))
    assert {mutant.after for mutant in mutants} == expected
    for mutant in mutants:
        assert ast.dump(ast.parse(mutant.source)) != ast.dump(ast.parse(body))
        assert mutant.before.encode() in path.read_bytes()


@pytest.mark.parametrize(
    ("code", "verdict"),
    [(0, "survives"), (1, "killed"), (None, "killed by the time it takes")],
)
def test_a_file_that_is_changed_is_put_back(
    script, tmp_path, monkeypatch, code, verdict
):
    path = tmp_path / "source.py"
    path.write_text("x = 1  # one\n")
    mutant, texts = next(script.mutants(path)), []

    def run(place, arguments, seconds):
        texts.append((path.read_text(), arguments[-1]))
        return code

    monkeypatch.setattr(script, "run", run)
    found = script.judge_mutant(tmp_path, mutant, ["a::b"], 1.0)
    assert found.replace("that ", "") == verdict
    assert path.read_text() == "x = 1  # one\n"
    assert texts == [("x = (2)  # one\n", "a::b")]
    assert script.judge_mutant(tmp_path, mutant, [], 1.0) == "not reached"


@pytest.mark.parametrize(
    ("row", "fault"),
    [
        (Row("case", "", "", 4.1), None),
        (Row("case", "", "", 3.9), "3.90 is under 4.00"),
        (Row("other", "", "", 0.95), None),
        (Row("other", "", "", 0.85), "0.85 is under 0.90"),
        (Row("case", "", "", 9.0, 0.999, 0.999, certified=True), "99.90%"),
        (Row("case", "", "", 9.0, 0.999, 0.999), None),
        (Row("case", "", "", 9.0, 0.9, 0.8), "80.00%"),
        (Row("case", "", "", 9.0, change=0.1, certified=True), "sum"),
        (Row("case", "", "", 9.0, change=0.1), None),
    ],
)
def test_a_fault_of_a_case_is_told(row, fault):
    table = Table({"case": 4.0})
    table.add(row)
    assert [fault in text for text in table.faults] == ([True] if fault else [])
