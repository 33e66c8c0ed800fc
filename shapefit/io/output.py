"""What a writer is told besides its records, and what it tells when its files are complete."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from shapefit.geometry.upright import Up


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """How shapes get into files in metres.

    height  of the body or the object in metres; by default results are as large as the training
            shapes of their dictionary
    unit    of shapes whose files do not say it
    up      axis of the shapes, or of the world that the extrinsics know, that points up
    """

    height: float | None = None
    unit: str | None = None
    up: Up | None = None

    @property
    def given(self) -> tuple[str, ...]:
        """Return the names of the options that are set."""
        return tuple(name for name, value in vars(self).items() if value is not None)


AS_KNOWN = OutputOptions()


@dataclass(frozen=True, kw_only=True)
class Summary:
    """What was written: the unit and axes, what to beware of, and the files if not the target."""

    note: str = ""
    warnings: tuple[str, ...] = ()
    written: tuple[Path, ...] = ()
