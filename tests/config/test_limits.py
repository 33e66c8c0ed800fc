"""Configs that would take all memory, hang, or break what comes after them."""

import warnings
from pathlib import Path

import pytest

from shapefit.config import load_config
from shapefit.config.yaml12 import MOST_VALUES, read_yaml
from shapefit.errors import InputError


def problems_of(text):
    return read_yaml(text, lambda line, column: f"{line}:{column}").problems


def problems(command, *overrides):
    with pytest.raises(InputError) as caught:
        load_config(command, None, overrides, {"output": "out"})
    return caught.value.problems


def bomb(levels):
    """Aliases of aliases: ten times as many values a level."""
    lists = ["&a [x,x,x,x,x,x,x,x,x,x]"]
    for number in range(levels):
        alias = f"*{chr(97 + number)}"
        lists.append(f"&{chr(98 + number)} [{','.join([alias] * 10)}]")
    return f"metrics: [{', '.join(lists)}]"


def test_aliases_of_aliases_are_counted():
    (line,) = problems_of(bomb(8))
    assert (
        line == f"1:1: more than {MOST_VALUES} values, aliases written out; a config must be small"
    )
    assert problems_of(bomb(2)) == []


def test_a_config_that_is_no_config_is_not_read_to_its_end():
    with pytest.raises(InputError, match="/dev/zero: larger than 1048576 bytes; give a config"):
        load_config("fit", Path("/dev/zero"))


@pytest.mark.parametrize("value", [2**63, -(2**63), 10**40])
def test_whole_numbers_have_64_bits(value):
    (line,) = problems_of(f"seed: {value}")
    assert line == "1:7: a whole number beyond 9223372036854775807; write a smaller one"
    assert problems_of(f"seed: {2**63 - 1}") == []


@pytest.mark.parametrize(
    "key",
    [
        "solver.max_iterations",
        "threads",
        "chunk",
        "alternation.views",
    ],
)
def test_numbers_of_steps_have_a_limit(key):
    lines = problems("fit", f"{key}=3000000000")
    assert any(line.startswith(f"--set {key}=3000000000: expected a whole") for line in lines)


def test_half_a_letter_is_no_text():
    lines = problems("fit", 'landmarks="\\ud800"')
    assert any("contains an unpaired surrogate" in line for line in lines)


def test_a_file_that_is_no_yaml_says_so_and_nothing_else(tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text("landmarks: a\n  b: [\n")
    with pytest.raises(InputError) as caught:
        load_config("fit", path)
    (line,) = caught.value.problems
    assert line.startswith(f"{path}:2:4: not valid YAML: ")


@pytest.mark.parametrize("text", ["%YAML 1.1\n---\nlam: 1e400\n", "a: &a 1\nb: &a 2\nc: *a\n"])
def test_what_yaml_only_frowns_on_is_not_told(text):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert problems_of(text) == []
