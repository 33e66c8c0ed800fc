"""The progress bar on stderr."""

from __future__ import annotations

from types import TracebackType
from typing import Any, Self

from shapefit.errors import printable

from .streams import tells_progress


class Progress:
    """A bar of the items done; nothing where stderr is not a terminal."""

    def __init__(self, command: str, unit: str) -> None:
        self._command = command
        self._unit = unit
        self._bar: Any = None

    def __enter__(self) -> Self:
        if tells_progress():
            from tqdm import tqdm

            self._bar = tqdm(desc=self._command, unit=f" {self._unit}", dynamic_ncols=True)
        return self

    def __exit__(
        self,
        _kind: type[BaseException] | None,
        _error: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.close()

    def advance(self, done: int, total: int | None, note: str) -> None:
        """Show that `done` more items of `total` (None where unknown) are done, and a note."""
        if self._bar is None:
            return
        if total is not None:
            self._bar.total = total
        self._bar.set_postfix_str(printable(note), refresh=False)
        self._bar.update(done)
