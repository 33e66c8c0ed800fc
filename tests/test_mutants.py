"""The script behind `make mutants` makes changes that run, and sees what the tests see."""

import ast
import sys
from importlib import import_module
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def script():
    sys.path.append(str(PROJECT / "tools"))
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
def test_every_kind_of_change_is_made_and_messages_are_left(script, tmp_path, text, expected):
    path = tmp_path / "source.py"
    body = f"def f():\n    'é'\n    {text.replace(chr(10), chr(10) + '    ')}\n"
    path.write_text(body, encoding="utf-8")
    mutants = list(script.mutants(path))
    assert {mutant.after for mutant in mutants} == expected
    for mutant in mutants:
        assert ast.dump(ast.parse(mutant.source)) != ast.dump(ast.parse(body))
        assert mutant.before.encode() in path.read_bytes()


@pytest.mark.parametrize(
    ("code", "verdict"), [(0, "survives"), (1, "killed"), (None, "killed by the time it takes")]
)
def test_a_file_that_is_changed_is_put_back(script, tmp_path, monkeypatch, code, verdict):
    path = tmp_path / "source.py"
    path.write_text("x = 1  # one\n")
    mutant, texts = next(script.mutants(path)), []

    def run(place, arguments, seconds):
        texts.append((path.read_text(), arguments[-1]))
        return code

    monkeypatch.setattr(script, "run", run)
    assert script.verdict(tmp_path, mutant, ["a::b"], 1.0).replace("that ", "") == verdict
    assert path.read_text() == "x = 1  # one\n"
    assert texts == [("x = (2)  # one\n", "a::b")]
    assert script.verdict(tmp_path, mutant, [], 1.0) == "not reached"
