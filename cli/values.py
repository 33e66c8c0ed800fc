"""Values of options: how each is read, and what a shell completes for it.

Which values are right is for the schema to say, of all keys at once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from shapefit.config.model import ConfigKey

Words = Callable[[click.Context, click.Parameter], Iterable[str]]
"""What finds the words to complete; called in a shell alone, as it may import much."""


class Value(click.ParamType):  # type: ignore[type-arg]  # click 8.1 has no argument
    """A text, for which a shell completes words, files, or both."""

    name = "text"

    def __init__(self, words: Words | None = None, *, files: bool = False) -> None:
        self.words = words
        self.files = files

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the words that begin with `incomplete`, and one item for all files."""
        from click.shell_completion import CompletionItem

        words = self.words(ctx, param) if self.words else ()
        items = [CompletionItem(word) for word in words if word.startswith(incomplete)]
        if self.files:
            items.append(CompletionItem(incomplete, type="file"))
        return items


class Setting(Value):
    """`KEY=VALUE`, for which a shell completes the key, and then words of that key."""

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the keys that begin with `incomplete`; after `KEY=`, values of KEY."""
        key, equals, _ = incomplete.partition("=")
        words = complete_setting if equals else complete_keys
        return Value(lambda *_: words(ctx, key)).shell_complete(ctx, param, incomplete)


class NumberOrWord(Value):
    """A number, or a word such as auto."""

    def convert(
        self,
        value: object,
        param: click.Parameter | None,
        ctx: click.Context | None,
    ) -> object:
        """Return a text as a number where it is one, else unchanged."""
        try:
            return float(str(value))
        except ValueError:
            return value


class Size(click.ParamType):  # type: ignore[type-arg]
    """Width and height in a text such as 1920x1080."""

    name = "size"

    def convert(
        self,
        value: object,
        param: click.Parameter | None,
        ctx: click.Context | None,
    ) -> list[float]:
        """Return [width, height] of a text such as 1920x1080."""
        try:
            width, height = map(float, str(value).lower().split("x"))
        except ValueError:
            fault = f"{value!r} is no size; give WIDTHxHEIGHT, such as 1920x1080"
            self.fail(fault, param, ctx)
        return [width, height]


def words_of_key(ctx: click.Context, param: click.Parameter) -> Iterable[str]:
    """Return the words that an option may have as value; () for numbers and names."""
    from shapefit.config.reference import words_of

    return words_of(keys_of(str(ctx.info_name))[key_path(str(param.name))])


def keys_of(command: str) -> Mapping[tuple[str, ...], ConfigKey]:
    """Return the keys of a command's config by their paths, {} without a config."""
    from shapefit.config import CONFIGS
    from shapefit.config.model import list_config_keys

    return list_config_keys(CONFIGS[command]) if command in CONFIGS else {}


def key_path(parameter: str) -> tuple[str, ...]:
    """Return the path of the key that an option sets: a__b is the key a.b."""
    return tuple(parameter.split("__"))


def complete_keys(ctx: click.Context, _key: str) -> Iterable[str]:
    """Return `key=` for each config key of the command, as completions of --set."""
    from shapefit.config import CONFIGS
    from shapefit.config.reference import describe_keys

    return [f"{row.name}=" for row in describe_keys(CONFIGS[str(ctx.info_name)])]


def complete_setting(ctx: click.Context, key: str) -> Iterable[str]:
    """Return `key=word` for each word that a config key may have as value."""
    from shapefit.config.reference import words_of

    found = keys_of(str(ctx.info_name)).get(tuple(key.split(".")))
    return [f"{key}={word}" for word in words_of(found)] if found else []


def sections(ctx: click.Context, _param: click.Parameter) -> Iterable[str]:
    """Return the dotted names of keys and sections of the command to be described."""
    return [".".join(path) for path in keys_of(str(ctx.params.get("command")))]


def dictionaries(_ctx: click.Context, _param: click.Parameter) -> Iterable[str]:
    """Return the names of the installed dictionaries."""
    from shapefit.config.paths import find_dictionaries

    return find_dictionaries()


def presets(ctx: click.Context, _param: click.Parameter) -> Iterable[str]:
    """Return the names of the installed configs of the command."""
    from shapefit.config.paths import find_presets

    return find_presets(str(ctx.info_name))


def skeletons(_ctx: click.Context, _param: click.Parameter) -> Iterable[str]:
    """Return the names of the skeletons that --keypoints takes."""
    from shapefit.io.skeletons import installed_skeletons

    return [*installed_skeletons(), "numbered"]


def input_formats(_ctx: click.Context, _param: click.Parameter) -> Iterable[str]:
    """Return the names of the formats that can be read."""
    from shapefit.io.detect import FORMATS

    return FORMATS


def output_formats(_ctx: click.Context, _param: click.Parameter) -> Iterable[str]:
    """Return the names of the formats that `convert` writes."""
    from shapefit.io.formats import MESH_FORMATS, TARGETS

    return [*TARGETS, *MESH_FORMATS]


def words_of_match(_ctx: click.Context, _param: click.Parameter) -> Iterable[str]:
    """Return the words for --match, which may also be the name of a dataset.

    It says by what an estimated shape finds its true one.
    """
    return ("item", "frame")


FILE = Value(files=True)
"""A file, a folder, a glob or -."""

TEXT = Value()
"""A name that no shell knows."""

WORD = Value(words_of_key)
"""One of the words of a key."""

NUMBER_OR_WORD = NumberOrWord(words_of_key)
DICTIONARY = Value(dictionaries, files=True)
CONFIG = Value(presets, files=True)
SKELETON = Value(skeletons)
SETTING = Setting()
SECTION = Value(sections)
INPUT_FORMAT = Value(input_formats)
OUTPUT_FORMAT = Value(output_formats)
MATCH = Value(words_of_match)
SIZE = Size()
