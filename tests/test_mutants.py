"""The script behind `make mutants` makes changes that run, and sees what the tests see."""

import ast
import importlib.util
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

PROJECT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def script():
    sys.path.append(str(PROJECT / "tools"))
    spec = importlib.util.spec_from_file_location("mutants", PROJECT / "tools/mutants.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["mutants"] = module
    spec.loader.exec_module(module)
    return module


def test_every_kind_of_change_is_made_and_messages_are_left(script, tmp_path):
    path = tmp_path / "source.py"
    text = (
        'def f(a, b: int = 1):\n    """A docstring."""\n    if a < b and not a:\n'
        '        raise ValueError("1" + str(a - 1))\n    return np.sqrt(a - b) * 2.5\n'
    )
    path.write_text(text)
    found = {(mutant.before, mutant.after) for mutant in script.mutants(path)}
    assert found == {
        ("1", "2"),
        ("a < b", "a <= b"),
        ("a < b and (not a)", "a < b or not a"),
        ("a < b and (not a)", "a < b"),
        ("not a", "a"),
        ("a - b", "a + b"),
        ("a - b", "a"),
        ("np.sqrt(a - b)", "a - b"),
        ("np.sqrt(a - b) * 2.5", "np.sqrt(a - b) / 2.5"),
        ("np.sqrt(a - b) * 2.5", "np.sqrt(a - b)"),
        ("2.5", "5.0"),
    }
    for mutant in script.mutants(path):
        assert ast.dump(ast.parse(mutant.source)) != ast.dump(ast.parse(text))


def test_a_change_has_the_tests_that_run_its_lines_those_of_its_folder_and_fast_ones_first(script):
    path = PROJECT / "shapefit/geometry/procrustes.py"
    a, b = "tests/geometry/test_a.py::a", "tests/geometry/test_b.py::b"
    c, d = "tests/convex/test_c.py::c", "tests/geometry/test_d.py::d"
    reach = script.Reach(
        contexts={str(path): {1: [""], 5: [a, "world"], 6: [a], 9: [c]}},
        seconds={a: 3.0, b: 1.0, c: 0.5, d: 9.0, "world": 1.0},
        needs={a: {a}, b: {b, "world"}, c: {c}, d: {d}},
        tests=[a, b, c, d],
    )
    assert script.tests_of(path, range(5, 6), reach, 60.0) == ([b, a], False)
    assert script.tests_of(path, range(5, 6), reach, 4.0) == ([b], False)
    assert script.tests_of(path, range(6, 10), reach, 60.0) == ([a, c], False)
    assert script.tests_of(path, range(7, 9), reach, 60.0) == ([], False)
    assert script.tests_of(path, range(2), reach, 60.0) == ([b, a, d, c], True)


def test_a_change_acts_in_memory_and_nowhere_else(script, tmp_path):
    path = tmp_path / "changed_in_memory.py"
    path.write_text("class A:\n    def f(self, x):\n        return [x + y for y in (1, 2)]\n")
    spec = importlib.util.spec_from_file_location("changed_in_memory", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    mutant = next(one for one in script.mutants(path) if one.after == "x - y")
    script.put_into_memory(mutant, [module.A.f])
    assert module.A().f(5) == [4, 3]
    assert "x + y" in path.read_text()


def test_a_file_that_is_changed_is_put_back(script, tmp_path, monkeypatch):
    path = tmp_path / "source.py"
    path.write_text("x = 1  # one\n")
    mutant = next(script.mutants(path))
    codes, seen = iter([0, 1]), []

    def run(command, **_):
        seen.append((path.read_text(), command[-1]))
        return SimpleNamespace(returncode=next(codes))

    monkeypatch.setattr(script.subprocess, "run", run)
    assert script.on_disk(mutant, ["a::b"], 1.0) == "survives"
    assert script.on_disk(mutant, ["a::b"], 1.0).startswith("killed")
    assert path.read_text() == "x = 1  # one\n"
    assert seen == [("x = 2", "a::b")] * 2
