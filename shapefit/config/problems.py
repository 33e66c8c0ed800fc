"""What a schema rejects, said in the words and places of the user."""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import get_close_matches

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from shapefit.config.expectation import dotted_keys, expectation, field_keys, submodel
from shapefit.config.old_keys import old_key, old_value
from shapefit.config.places import Location
from shapefit.config.settings import Settings, found


def schema_problems(
    model: type[BaseModel], error: ValidationError, settings: Settings
) -> list[str]:
    """Return one line for each thing that the schema of `model` rejects in `settings`.

    A key whose value cannot be read is not missing.
    """
    details = [
        detail
        for detail in error.errors()
        if not (detail["type"] == "missing" and detail["loc"] in settings.refused)
    ]
    return list(dict.fromkeys(_problem(model, detail, settings) for detail in details))


def _problem(model: type[BaseModel], detail: ErrorDetails, settings: Settings) -> str:
    location = detail["loc"]
    owner, field = _schema_at(model, location)
    match detail["type"]:
        case "extra_forbidden":
            place = settings.place(location, key=True)
            gone = old_key(_commands_at(model, location))
            if gone:
                return f"{place}: {gone}"
            return f"{place}: unknown key {str(location[-1])!r}{_known(model, owner, location)}"
        case "missing" if field and field is field_keys(owner).get(str(location[-1])):
            place = settings.place(location[:-1])
            return f"{place}: missing key {str(location[-1])!r} ({field.description})"
        case "value_error":
            message = str(detail["ctx"]["error"])
            return f"{settings.place(_first_named(message, location, settings))}: {message}"
    gone = old_value(_commands_at(model, location), detail["input"])
    if gone:
        return f"{settings.place(location)}: {gone}"
    choices = re.findall(r"'([^']+)'", detail.get("ctx", {}).get("expected", ""))
    wanted = " or ".join(choices) or (expectation(field) if field else detail["msg"])
    return (
        f"{settings.place(location)}: expected {wanted}, "
        f"found {found(detail['input'])}{_did_you_mean(str(detail['input']), choices)}"
    )


def _first_named(message: str, location: Location, settings: Settings) -> Location:
    """Return where the first of the keys was said that a message names as `key` or `key: value`.

    Of keys that do not go together none is at fault alone; their common `location` is the answer
    where the settings say none of them.
    """
    named = ((*location, word) for word in re.findall(r"`(\w+)", message))
    return next(filter(settings.said, named), location)


def _schema_at(
    model: type[BaseModel], location: Location
) -> tuple[type[BaseModel], FieldInfo | None]:
    """Return the field that `location` is or lies in (None if unknown), and its owner.

    A problem of several keys together lies in none of them: its location is empty.
    """
    if not location:
        return model, None
    owner = model
    for key in location[:-1]:
        field = field_keys(owner)[str(key)]
        inner = submodel(field)
        if inner is None:
            return owner, field
        owner = inner
    return owner, field_keys(owner).get(str(location[-1]))


def _commands_at(model: type[BaseModel], location: Location) -> list[tuple[str, str]]:
    """Return each config of a command around `location`, by the name of its schema, with the key.

    A sweep holds the configs of other commands.
    """
    found = []
    for depth in range(len(location)):
        key = ".".join(map(str, location[depth:]))
        owner = _schema_at(model, location[: depth + 1])[0]
        found += [(kind.__name__, key) for kind in owner.__mro__]
    return found


def _known(model: type[BaseModel], owner: type[BaseModel], location: Location) -> str:
    """Return the end of a message on an unknown key: the nearest key, or all that are known."""
    key = str(location[-1])
    guess = _did_you_mean(key, field_keys(owner))
    if not guess:
        elsewhere = [known for known in dotted_keys(model) if known.split(".")[-1] == key]
        guess = "".join(f"; did you mean {known!r}?" for known in elsewhere[:1])
    return guess or f"; the keys here are {', '.join(field_keys(owner))}"


def _did_you_mean(text: str, choices: Iterable[str]) -> str:
    nearest = get_close_matches(text, list(choices), n=1)
    return f"; did you mean {nearest[0]!r}?" if nearest else ""
