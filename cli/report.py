"""What a command did, folded from the outcomes of its pipeline, and how far it is."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

from shapefit.errors import printable

from .streams import tell, tells_progress

if TYPE_CHECKING:
    from shapefit.pipelines.outcome import Counted, Failure, Outcome

LISTED = 20
"""Failures (and different warnings) that are listed; the rest is counted."""

LISTED_FILES = 8
"""Files in one folder that are named; more are counted."""


@dataclass
class Report:
    """The sum of a pipeline's outcomes; memory does not grow with the number of items.

    A `quiet` one has no warnings and no summary; a `verbose` one lists everything.
    """

    command: str
    unit: str
    quiet: bool = False
    verbose: bool = False
    done: int = 0
    failed: int = 0
    note: str = ""
    written: list[Path] = field(default_factory=list)
    _failures: list[Failure] = field(default_factory=list)
    _warnings: dict[str, str | Counted] = field(default_factory=dict)
    _doubts: dict[str, str | Counted] = field(default_factory=dict)
    _unlisted_warnings: int = 0
    _started: float = field(default_factory=time.monotonic)

    def add(self, outcome: Outcome) -> None:
        """Take in what became of one more part of the work."""
        from shapefit.pipelines.outcome import add_up

        self.done += outcome.done
        self.unit = outcome.unit or self.unit
        self.failed += len(outcome.failures)
        self._failures += outcome.failures[: self._most_listed - len(self._failures)]
        self._unlisted_warnings += add_up(self._warnings, outcome.warnings, self._most_listed)
        add_up(self._doubts, (d if self.verbose else replace(d, items=()) for d in outcome.doubts))
        self.written += outcome.written
        self.note = outcome.note or self.note

    @property
    def _most_listed(self) -> int:
        return sys.maxsize if self.verbose else LISTED

    @property
    def exit_code(self) -> int:
        """Return 0 if no item failed, otherwise 1."""
        return 1 if self.failed else 0

    def lines(self, *, with_note: bool = True) -> Iterator[str]:
        """Yield the report as lines of text: warnings, failures, then one line on everything."""
        from shapefit.pipelines.outcome import Note

        if not self.quiet:
            for warning in self._warnings.values():
                yield f"{'Note' if isinstance(warning, Note) else 'Warning'}: {warning}"
            if self._unlisted_warnings:
                yield f"Warning: and {self._unlisted_warnings} more"
            yield from self._not_to_be_trusted()
        for failure in self._failures:
            yield f"Failed: {failure.item}: {failure.reason}"
        if self.failed > len(self._failures):
            yield f"Failed: and {self.failed - len(self._failures)} more"
        if not self.quiet:
            yield "; ".join(self._summary(with_note))

    def _not_to_be_trusted(self) -> Iterator[str]:
        from shapefit.pipelines.outcome import Counted, tell_doubts

        doubts = [doubt for doubt in self._doubts.values() if isinstance(doubt, Counted)]
        for doubt in doubts:
            yield from (f"Doubtful: {item}: {doubt.text}" for item in doubt.items)
        if doubts:
            yield tell_doubts(doubts, self.done) + ("" if self.verbose else "; -v lists them")

    def _summary(self, with_note: bool) -> Iterator[str]:
        from shapefit.errors import counted

        seconds = time.monotonic() - self._started
        failed = f", {self.failed} failed" if self.failed else ""
        yield f"{self.command}: {counted(self.done, self.unit)} in {seconds:.1f} s{failed}"
        if with_note and self.note:
            yield self.note
        if self.written:
            yield f"wrote {self._files()}"

    def _files(self) -> str:
        folders = {path.parent for path in self.written}
        if len(self.written) > LISTED_FILES and len(folders) == 1 and not self.verbose:
            return f"{len(self.written)} files in {folders.pop().resolve()}"
        return ", ".join(map(_shown, self.written))


def _shown(path: Path) -> str:
    """Return the path as a user would say it: relative to the working directory if inside."""
    if path == Path("-"):
        return "standard output"
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)


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
