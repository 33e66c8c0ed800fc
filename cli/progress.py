"""Progress on stderr: a bar on a terminal, and a line now and then elsewhere."""

from __future__ import annotations

import time
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from shapefit.errors import printable

from .streams import tell, tells_progress

if TYPE_CHECKING:
    from .report import Report

SECONDS_BETWEEN_LINES = 10.0


class Progress:
    """How far the work is; nothing where the report is quiet."""

    def __init__(self, report: Report) -> None:
        self._report = report
        self._bar: Any = None
        self._started = self._last = time.monotonic()

    def __enter__(self) -> Self:
        if tells_progress() and not self._report.quiet:
            from tqdm import tqdm

            self._bar = tqdm(desc=self._report.command, dynamic_ncols=True)
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
        if self._bar is not None:
            if total is not None:
                self._bar.total = total
            self._bar.unit = f" {self._report.unit}"
            self._bar.set_postfix_str(printable(note), refresh=False)
            self._bar.update(done)
        elif not self._report.quiet and time.monotonic() - self._last >= SECONDS_BETWEEN_LINES:
            self._last = time.monotonic()
            tell(self._line(total, note))

    def show(self, line: str) -> None:
        """Show a line of its own, above the bar."""
        if self._report.quiet:
            return
        if self._bar is not None:
            self._bar.clear()
        tell(line)

    def _line(self, total: int | None, note: str) -> str:
        reached = f"{self._report.done}" + (f" of {total}" if total is not None else "")
        seconds = self._last - self._started
        words = f"{self._report.command}: {reached} {self._report.unit}s, {seconds:.0f} s"
        return f"{words}; {note}" if note else words
