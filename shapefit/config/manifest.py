"""`manifest.jsonl` of a folder of results, read by a model as configs are.

Its first line is of the run; each other line is of a part, added when the part ends.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from shapefit.errors import InputError, input_error, printable

MANIFEST = "manifest.jsonl"
"""In a folder of results, the list of them."""

EARLIER_MANIFEST = "manifest.json"
"""The list of results that version 0.2 wrote."""

DONE: Final = "done"
FAILED: Final = "failed"
PartStatus = Literal["done", "failed"]
"""Status of a part in the manifest."""

MAX_NUMBER = 2**63 - 1
"""That a manifest can hold; more is no size of anything."""

PartCount = Annotated[int, Field(ge=0, le=MAX_NUMBER)]
ChangeTime = Annotated[int, Field(ge=-MAX_NUMBER, le=MAX_NUMBER)]
PathName = Annotated[str, Field(pattern=r"^[^\x00]+$")]
PartName = Annotated[str, Field(pattern=r"^part-[0-9]{5,9}\.h5$")]
"""Files of no other name are results: none outside of the folder, and no device."""


def part_name(number: int) -> str:
    """Return the name of the file of a part."""
    return f"part-{number:05}.h5"


def part_number(file: str) -> int:
    """Return the number of a part from the name of its file."""
    return int(file.removeprefix("part-").removesuffix(".h5"))


class ManifestLine(BaseModel):
    """A line of a manifest; keys of later versions are kept as they are."""

    model_config = ConfigDict(strict=True, frozen=True, extra="allow")


class RunLine(ManifestLine):
    """The line of a run: what all its parts depend on.

    `parts` are the numbers of the files that it writes, `removed` those of an earlier
    run that it removes; a file that is in neither, and has no line, is of somebody
    else. Further keys are digests: of the config, the dictionary and other files that
    it names.
    """

    __pydantic_extra__: dict[str, str] = Field(init=False)

    shapefit: str
    method: str
    estimated: dict[str, Any]
    parts: tuple[PartCount, ...] = ()
    removed: tuple[PartCount, ...] = ()

    @property
    def digests(self) -> Mapping[str, str]:
        """The digests of all that every part depends on, by their keys."""
        return self.__pydantic_extra__


class PartLine(ManifestLine):
    """The line of a part: what it is made of, and what became of it.

    rows (start, stop) of the one input, None for all; states, the bytes and time of
    change of each input; images, how many of them `failed`, how many are trusted, of
    methods with a prior, and how many are solved to their tolerance or not, with the
    largest gap, for methods that state one; `bytes` and digest of the contents of the
    result.
    """

    file: PartName
    inputs: Annotated[tuple[PathName, ...], Field(min_length=1)]
    rows: tuple[PartCount, PartCount] | None
    states: tuple[tuple[PartCount, ChangeTime], ...]
    status: PartStatus
    images: PartCount = 0
    failed: PartCount = 0
    trusted: PartCount | None = None
    optimal: PartCount | None = None
    not_optimal: PartCount | None = None
    largest_gap: Annotated[float, Field(ge=0)] | None = None
    bytes: PartCount = 0
    digest: str = ""
    seconds: Annotated[float, Field(ge=0, strict=False)] = 0.0
    error: str = ""

    @model_validator(mode="after")
    def _check_whole(self) -> Self:
        """Raise ValueError where a line lacks what a part with its status has."""
        needed = {"images", "failed", "bytes"} if self.status == DONE else {"error"}
        missing = sorted(needed - self.model_fields_set)
        if missing:
            raise ValueError(f"{self.status}, but without {', '.join(missing)}")
        if len(self.states) != len(self.inputs):
            raise ValueError("as many states as inputs are needed")
        if self.rows is not None and self.rows[0] >= self.rows[1]:
            raise ValueError("rows begin before they end")
        return self


AnyLine = TypeVar("AnyLine", RunLine, PartLine)


def read_lines(folder: Path) -> tuple[RunLine, list[PartLine]] | None:
    """Return the lines of run and parts in a folder's manifest, None without one.

    Of the lines of a part the last counts. A line without an end was being written, and
    is omitted. Raises InputError, which names the line, where a file of that name is
    something else.
    """
    path = folder / MANIFEST
    if not path.is_file():
        return None
    try:
        lines = path.read_bytes().split(b"\n")[:-1]
    except OSError as error:
        raise manifest_error(path, str(error.strerror)) from error
    if not lines:
        raise manifest_error(path, "it has no line")
    run = _read_line(RunLine, lines[0], f"{path}:1")
    parts = [
        _read_line(PartLine, line, f"{path}:{number}")
        for number, line in enumerate(lines[1:], start=2)
    ]
    return run, parts


def _read_line(kind: type[AnyLine], text: bytes, place: str) -> AnyLine:
    """Parse a line by the model `kind`; else raise InputError at `place`."""
    try:
        return kind.model_validate_json(text)
    except ValidationError as error:
        problem = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(map(str, problem["loc"]))
        reason = f"{where}: {problem['msg']}" if where else problem["msg"]
        raise manifest_error(place, printable(reason)) from None


def manifest_error(place: str | Path, reason: str) -> InputError:
    """Make the error that the file `place` is no manifest of results, for a reason."""
    fix = f"name another folder, or remove {MANIFEST} and fit with --replace"
    return input_error(place, f"is not a manifest of results ({reason:.300})", fix)


def result_parts(folder: Path) -> tuple[Path, ...]:
    """Return the results in a folder that `fit` wrote part by part, by their numbers.

    There are none for anything else. Raises InputError as `read_lines`.
    """
    lines = read_lines(folder)
    if lines is None:
        return ()
    _, parts = lines
    status = {part.file: part.status for part in parts}
    names = [name for name in status if status[name] == DONE]
    # the number of a part is as long as it must be
    in_order = sorted(names, key=lambda name: (len(name), name))
    return tuple(folder / name for name in in_order)
