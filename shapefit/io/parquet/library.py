"""pyarrow, the extra `parquet`; InputError where it is not installed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from shapefit.errors import input_error

try:
    import pyarrow
    import pyarrow.compute
    import pyarrow.parquet
except ImportError as error:
    found = "these files need the library pyarrow, which is not installed"
    raise input_error("Parquet", found, "run `pip install pyarrow`") from error

__all__ = ["damage", "pyarrow"]

FAULTS = (
    *(pyarrow.ArrowException, OSError, RuntimeError),
    *(KeyError, TypeError, ValueError, MemoryError),
)


@contextmanager
def damage(place: str | Path) -> Iterator[None]:
    """Turn what pyarrow raises for a truncated or damaged file into an InputError."""
    try:
        yield
    except FAULTS as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        fix = "the file may be cut off or damaged: copy or make it again"
        raise input_error(place, f"cannot be read ({reason})", fix) from error
