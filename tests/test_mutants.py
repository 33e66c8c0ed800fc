"""The script behind `make mutants` makes changes that run, and sees what the tests see."""

import ast
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

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
        ("not a", {"a"}),
        ("np.sqrt(a - b)", {"a - b", "a + b", "a"}),
        ("max(x)", {"min(x)"}),
        ("f(a, b, k=c)", {"f(b, a, k=c)", "f(a, b)"}),
        ("f(*a, b)", set()),
        ("2.5", {"5.0"}),
        ("'é' + str(1)", {"2"}),
        ("b if a else c", {"not a"}),
        ("raise E(1)", set()),
        ("if a:\n    return", {"not a", "False"}),
        ("if a:\n    b()", {"not a"}),
        ("x: int = 1", {"2"}),
    ],
)
def test_every_kind_of_change_is_made_and_messages_are_left(script, tmp_path, text, expected):
    path = tmp_path / "source.py"
    body = f"def f():\n    'é'\n    {text.replace(chr(10), chr(10) + '    ')}\n"
    path.write_text(body, encoding="utf-8")
    found = list(script.mutants(path))
    assert {mutant.after for mutant in found} == expected
    for mutant in found:
        assert ast.dump(ast.parse(mutant.source)) != ast.dump(ast.parse(body))
        assert mutant.before.encode() in path.read_bytes()
        assert mutant.lines == range(3, 4)


def test_a_change_has_the_tests_that_run_its_lines_those_of_its_folder_and_fast_ones_first(script):
    path = Path("shapefit/geometry/procrustes.py")
    seconds = {"a": 3.0, "b": 1.0, "c": 0.5, "d": 9.0}
    folders = {"a": "geometry", "b": "geometry", "c": "convex", "d": "geometry"}
    names = {test: f"tests/{folders[test]}/test_{test}.py::{test}" for test in seconds}
    lines = {1: [""], 5: ["a", "b", "failing"], 6: ["a"], 9: ["c"]}
    reach = script.Reach({str(path): lines}, names, seconds)
    for changed, limit, expected in (
        (range(5, 6), 60.0, "ba"),
        (range(5, 6), 3.5, "b"),
        (range(6, 10), 60.0, "ac"),
        (range(7, 9), 60.0, ""),
        (range(1, 2), 60.0, "badc"),
    ):
        assert script.tests_of(path, changed, reach, limit) == [names[test] for test in expected]


def test_tests_are_named_as_coverage_and_pytest_name_them_and_failing_ones_left_out(script):
    case = '<testcase file="tests/a/test_b.py" classname="tests.a.test_b{}" name="{}" time="1"{}'
    cases = [
        case.format("", "test_c[1]", "/>"),
        case.format("", "test_c[2]", "/>"),
        case.format(".TestD", "test_e", "/>"),
        case.format("", "test_f", "><failure/></testcase>"),
    ]
    names, seconds = script.passing(ElementTree.fromstring(f"<all>{''.join(cases)}</all>"))
    assert names == {
        "tests.a.test_b.test_c": "tests/a/test_b.py::test_c",
        "tests.a.test_b.TestD.test_e": "tests/a/test_b.py::TestD::test_e",
    }
    assert seconds["tests.a.test_b.test_c"] == 2


@pytest.mark.parametrize(
    ("code", "told"), [(0, "survives"), (1, "killed"), (None, "killed by the time that it takes")]
)
def test_a_file_that_is_changed_is_put_back(script, tmp_path, monkeypatch, code, told):
    path = tmp_path / "source.py"
    path.write_text("x = 1  # one\n")
    mutant = next(script.mutants(path))
    visible = SimpleNamespace()

    def run(place, arguments, seconds):
        visible.text, visible.test = path.read_text(), arguments[-1]
        return code

    monkeypatch.setattr(script, "run", run)
    assert script.verdict(tmp_path, mutant, ["a::b"], 1.0) == told
    assert path.read_text() == "x = 1  # one\n"
    assert (visible.text, visible.test) == ("x = (2)  # one\n", "a::b")
    assert script.verdict(tmp_path, mutant, [], 1.0) == "not reached"
