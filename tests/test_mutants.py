"""The script behind `make mutants` makes changes that run, and sees what the tests see."""

import ast
import importlib.util
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("mutants", PROJECT / "building/mutants.py")
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


def test_the_nearest_tests_mirror_a_file(script):
    file = PROJECT / "shapefit/geometry/procrustes.py"
    own, folder = script.nearest_tests(file)[0], script.nearest_tests(file)[-1]
    assert own.endswith("tests/geometry/test_procrustes.py")
    assert folder.endswith("tests/geometry")
    through = script.nearest_tests(PROJECT / "shapefit/verification/tree.py")
    assert any(place.endswith("tests/pipelines/verify") for place in through)
