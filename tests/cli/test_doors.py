"""Options, words that a shell completes, and keywords of Python follow the schema."""

import inspect
import types
import typing

import click
import pytest
from shapefit.cli.main import commands
from shapefit.cli.options import COMMON
from shapefit.cli.values import Value, key_path, words_of_key

import shapefit
from shapefit.config import CONFIGS
from shapefit.config.model import list_config_keys
from shapefit.config.reference import words_of

WITHOUT_KEY = {
    "fit": {
        "partition",
        "workers",
        "scheduler",
        "scheduler_file",
        "replace_others",
        "fail_untrusted",
        "live",
    },
    "view": {"show"},
}
"""Options of a command that are not keys of its config."""

BESIDE_KEYS = {
    "fit": {"weights", "config", "progress"},
    "learn-dict": {"progress"},
    "eval": {"result", "progress"},
}
"""Keywords of functions that are not keys."""

FUNCTIONS = {
    "fit": shapefit.fit,
    "learn-dict": shapefit.learn,
    "eval": shapefit.evaluate,
}


def options_of(command):
    """Yield the parameters of a command that set keys."""
    other = {*COMMON, *WITHOUT_KEY.get(command, ())}
    return [one for one in commands.commands[command].params if one.name not in other]


@pytest.mark.parametrize("command", CONFIGS)
def test_every_option_sets_a_key(command):
    keys = list_config_keys(CONFIGS[command])
    assert [
        one.name for one in options_of(command) if key_path(one.name) not in keys
    ] == []


@pytest.mark.parametrize("command", CONFIGS)
def test_a_shell_completes_every_word_of_a_key(command):
    keys = list_config_keys(CONFIGS[command])
    context = click.Context(commands.commands[command], info_name=command)
    for option in options_of(command):
        words = words_of(keys[key_path(option.name)])
        if isinstance(option.type, Value) and option.type.words is words_of_key:
            offered = [
                one.value for one in option.type.shell_complete(context, option, "")
            ]
            assert offered == words != [], option.name
        else:
            assert set(words) <= {"auto"}, f"{option.name} has words; give it WORD"


def test_a_command_without_a_config_has_none():
    assert "verify" not in CONFIGS
    assert list(CONFIGS) == [one for one in CONFIGS if one in CONFIGS]


@pytest.mark.parametrize("command", [*CONFIGS, "verify"])
def test_every_option_says_what_it_is_for_and_is_listed_once(command):
    options = [
        one
        for one in commands.commands[command].params
        if isinstance(one, click.Option)
    ]
    assert [one.name for one in options if not one.help] == []
    spelled = [name for option in options for name in option.opts]
    assert len(spelled) == len(set(spelled))


@pytest.mark.parametrize("command", FUNCTIONS)
def test_every_keyword_of_python_is_a_key_with_the_same_words(command):
    keys = list_config_keys(CONFIGS[command])
    hints = typing.get_type_hints(FUNCTIONS[command])
    for parameter in inspect.signature(FUNCTIONS[command]).parameters.values():
        name = {"lam": "lambda"}.get(parameter.name, parameter.name)
        if parameter.kind == parameter.VAR_KEYWORD or name in BESIDE_KEYS[command]:
            continue
        assert (name,) in keys, name
        named = set(literals(hints[parameter.name]))
        assert named in (set(), set(words_of(keys[name,]))), name


def literals(kind):
    """Yield the texts that a type names, each type of a union; not those in a list or a
    mapping, which a shell does not complete.
    """
    if typing.get_origin(kind) is typing.Literal:
        yield from typing.get_args(kind)
    elif typing.get_origin(kind) in (typing.Union, types.UnionType):
        for part in typing.get_args(kind):
            yield from literals(part)
