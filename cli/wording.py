"""Messages in the words of the command line: options in the place of keys.

Below the command line a message names keys, as a YAML file and Python have them.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping

import click

from .values import key_path

KEY_IN_TEXT = re.compile(r"`([a-z][a-z_.]*)(?:(?:: |=)([^`]+))?`")
"""`key`, `key: value` or `key=value`."""

PAIR = re.compile(r"^\[(\d+), ?(\d+)\]$")
"""A list of two numbers, which is a size such as 1920x1080 as an option."""

KEY_AS_PLACE = re.compile(r"([a-z][a-z_.]*)(?=: )")
"""What a problem is of, at its beginning."""


def options_of_keys(command: click.Command) -> dict[str, str]:
    """Return config key -> option of a command, such as camera.focal -> --focal.

    A key of a section is there without its section, too, as messages about a section
    name it. Flags, which have no value, are left out.
    """
    options = {}
    for one in command.params:
        if isinstance(one, click.Option) and not one.is_flag:
            path = key_path(str(one.name))
            options[path[-1]] = options[".".join(path)] = one.opts[-1]
    return options


def name_options(text: str, options: Mapping[str, str], keys: Collection[str]) -> str:
    """Return a message with options, or `--set key=value`, in place of config keys."""

    def name_option(found: re.Match[str]) -> str:
        """Return the option for a matched key, with its value if the text has one."""
        key, value = found.groups()
        if key in options:
            typed = PAIR.sub(r"\1x\2", value or "")
            return f"`{f'{options[key]} {typed}'.rstrip()}`"
        if value and key in keys:
            setting = f"{key}={value}"
            quoted = f"'{setting}'" if re.search(r"[^\w.=+-]", setting) else setting
            return f"`--set {quoted}`"
        return found[0]

    return place_in_options(KEY_IN_TEXT.sub(name_option, text), options)


def place_in_options(text: str, options: Mapping[str, str]) -> str:
    """Return a message with the config key at its beginning replaced by its option."""
    place = KEY_AS_PLACE.match(text)
    if place is None:
        return text
    return options.get(place[1], place[1]) + text[place.end() :]
