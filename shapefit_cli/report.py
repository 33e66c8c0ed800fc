"""What a command did, folded from the outcomes of its pipeline."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from shapefit.pipelines.outcome import Failure, Outcome

LISTED = 20
"""Failures (and different warnings) that are listed; the rest is counted."""

LISTED_FILES = 3
"""Files in one folder that are named; more are counted."""


@dataclass
class Report:
    """The sum of a pipeline's outcomes; memory does not grow with the number of items."""

    command: str
    unit: str
    done: int = 0
    failed: int = 0
    note: str = ""
    written: list[Path] = field(default_factory=list)
    _failures: list[Failure] = field(default_factory=list)
    _warnings: Counter[str] = field(default_factory=Counter)
    _unlisted_warnings: int = 0
    _started: float = field(default_factory=time.monotonic)

    def add(self, outcome: Outcome) -> None:
        """Take in what became of one more stretch of the work."""
        self.done += outcome.done
        self.failed += len(outcome.failures)
        self._failures += outcome.failures[: LISTED - len(self._failures)]
        for warning in outcome.warnings:
            if warning in self._warnings or len(self._warnings) < LISTED:
                self._warnings[warning] += 1
            else:
                self._unlisted_warnings += 1
        self.written += outcome.written
        self.note = outcome.note or self.note

    @property
    def exit_code(self) -> int:
        """Return 0 if no item failed, otherwise 1."""
        return 1 if self.failed else 0

    def lines(self, *, with_note: bool = True) -> Iterator[str]:
        """Yield the report as lines of text: warnings, failures, then one line on everything."""
        for warning, times in self._warnings.items():
            yield f"Warning: {warning}" + (f" ({times} times)" if times > 1 else "")
        if self._unlisted_warnings:
            yield f"Warning: and {self._unlisted_warnings} more"
        for failure in self._failures:
            yield f"Failed: {failure.item}: {failure.reason}"
        if self.failed > len(self._failures):
            yield f"Failed: and {self.failed - len(self._failures)} more"
        yield "; ".join(self._summary(with_note))

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
        if len(self.written) > LISTED_FILES and len(folders) == 1:
            return f"{len(self.written)} files in {_shown(folders.pop())}"
        return ", ".join(map(_shown, self.written))


def _shown(path: Path) -> str:
    """Return the path as a user would say it: relative to the working directory if inside."""
    if path == Path("-"):
        return "standard output"
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)
