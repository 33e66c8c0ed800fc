"""What a command did, folded from the outcomes of its pipeline, and how far it is."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from shapefit.errors import printable

from .streams import tell

if TYPE_CHECKING:
    from shapefit.pipelines.outcome import Counted, Failure, Outcome

LISTED = 20
"""Failures (and different warnings) that are listed; the rest is counted."""
LISTED_FILES = 8
"""Files in one folder that are named; more are counted."""
WIDTH, LABEL = 110, 8
"""Characters of a line of the summary, and of the label before it."""
SECONDS_BETWEEN_LINES = 10.0
"""Of the progress where standard error is no terminal."""


@dataclass
class Report:
    """The sum of a pipeline's outcomes; memory does not grow with the number of items.

    A `quiet` one has no warnings and no summary; a `verbose` one lists everything. A pipeline that
    `prints_note` has the result of the command, for standard output, as its last note. With
    `as_json` all goes there as one object; with more than the share `most_untrusted` of items that
    are not to be trusted the exit code is 1.
    """

    command: str
    unit: str
    quiet: bool = False
    verbose: bool = False
    prints_note: bool = False
    as_json: bool = False
    most_untrusted: float | None = None
    done: int = 0
    failed: int = 0
    total: int | None = None
    note: str = ""
    rows: tuple[tuple[str, str], ...] = ()
    written: list[Path] = field(default_factory=list)
    data: Callable[[], Any] = lambda: None
    _failures: list[Failure] = field(default_factory=list)
    _warnings: dict[str, str | Counted] = field(default_factory=dict)
    _doubts: dict[str, str | Counted] = field(default_factory=dict)
    _listing: list[str] = field(default_factory=list)
    _unlisted_warnings: int = 0
    _started: float = field(default_factory=time.monotonic)

    def follow(self, outcomes: Iterator[Outcome]) -> int:
        """Run a pipeline to its end, show its progress, tell what it did; return the exit code."""
        with ExitStack() as stack:
            stack.enter_context(closing(outcomes))  # type: ignore[type-var]
            bar: Any = None
            if sys.stderr is not None and sys.stderr.isatty() and not self.quiet:
                from tqdm import tqdm

                bar = stack.enter_context(tqdm(desc=self.command, dynamic_ncols=True))
            told = time.monotonic()
            for outcome in outcomes:
                self.add(outcome)
                for row in outcome.listing:
                    if not self.as_json:
                        click.echo(printable(row))
                note = "" if self.prints_note else outcome.note
                if outcome.line and not self.quiet:
                    if bar is not None:
                        bar.clear()
                    tell(outcome.line)
                if bar is not None:
                    bar.total = bar.total if outcome.total is None else outcome.total
                    bar.unit = f" {self.unit}"
                    bar.set_postfix_str(printable(note), refresh=False)
                    bar.update(outcome.done)
                elif not self.quiet and time.monotonic() - told >= SECONDS_BETWEEN_LINES:
                    told = time.monotonic()
                    tell(self._progress(outcome.total, note))
        if self.as_json:
            import json

            click.echo(json.dumps(self.values(), ensure_ascii=False, default=str))
            return self.exit_code
        if self.prints_note:
            click.echo(self.note)
        for line in self.lines():
            tell(line)
        return self.exit_code

    def add(self, outcome: Outcome) -> None:
        """Take in what became of one more part of the work."""
        from shapefit.pipelines.outcome import add_up

        self.done += outcome.done
        self.unit = outcome.unit or self.unit
        self.failed += len(outcome.failures)
        self.total = self.total if outcome.total is None else outcome.total
        self._failures += outcome.failures[: self._most_listed - len(self._failures)]
        self._unlisted_warnings += add_up(self._warnings, outcome.warnings, self._most_listed)
        add_up(self._doubts, (d if self.verbose else replace(d, items=()) for d in outcome.doubts))
        self.written += outcome.written
        self.note = outcome.note or self.note
        self.rows = outcome.rows or self.rows
        self.data = outcome.data or self.data
        self._listing += outcome.listing if self.as_json else ()

    @property
    def _most_listed(self) -> int:
        return sys.maxsize if self.verbose else LISTED

    @property
    def exit_code(self) -> int:
        """Return 0 if no item failed, one was there, and enough are to be trusted, otherwise 1."""
        return 1 if self.failed or self.total == 0 or self._too_few_trusted else 0

    @property
    def _untrusted(self) -> dict[str, int]:
        """Return the reasons not to trust items, each with their number."""
        return {reasons.text: reasons.number for reasons in self._counted_doubts}

    @property
    def _counted_doubts(self) -> list[Counted]:
        from shapefit.pipelines.outcome import Counted

        return [reasons for reasons in self._doubts.values() if isinstance(reasons, Counted)]

    @property
    def _too_few_trusted(self) -> bool:
        most = self.most_untrusted
        return most is not None and sum(self._untrusted.values()) > most * self.done

    def values(self) -> dict[str, Any]:
        """Return the report as values of JSON."""
        return {
            "command": self.command,
            "unit": self.unit,
            "done": self.done,
            "failed": self.failed,
            "untrusted": self._untrusted,
            "failures": [{"item": each.item, "reason": each.reason} for each in self._failures],
            "warnings": [str(warning) for warning in self._warnings.values()],
            "note": self.note,
            "summary": dict(self.rows),
            "listing": self._listing,
            "written": [str(path) for path in self.written],
            "seconds": round(time.monotonic() - self._started, 3),
            "data": self.data(),
        }

    def lines(self) -> Iterator[str]:
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
        if self._too_few_trusted:
            share = sum(self._untrusted.values()) / self.done
            yield f"Failed: {share:.0%} are not to be trusted, more than --fail-untrusted allows"
        if not self.quiet and self.rows:
            yield from self._table()
        elif not self.quiet:
            yield "; ".join(self._summary())

    def _not_to_be_trusted(self) -> Iterator[str]:
        from shapefit.pipelines.outcome import tell_doubts

        doubts = self._counted_doubts
        for reasons in doubts:
            yield from (f"Doubtful: {item}: {reasons.text}" for item in reasons.items)
        if doubts:
            yield tell_doubts(doubts, self.done) + ("" if self.verbose else "; -v lists them")

    def _table(self) -> Iterator[str]:
        """Yield the rows of the summary, aligned; what matters last comes last."""
        from textwrap import wrap

        rows = dict(self.rows)
        seconds = f"{time.monotonic() - self._started:.1f} s"
        failed = f", {self.failed} failed" if self.failed else ""
        rows["Result"] = f"{rows.get('Result', self.done)}{failed}, {seconds}"
        following = rows.pop("Next", "")
        rows |= {"Wrote": self._files()} if self.written else {}
        rows |= {"Details": self.note} if self.verbose and self.note else {}
        rows |= {"Next": following} if following else {}
        for label, text in rows.items():
            first, *others = wrap(text, WIDTH - LABEL, break_long_words=False) or [""]
            yield f"{label:{LABEL}}{first}"
            yield from (f"{'':{LABEL}}{other}" for other in others)

    def _summary(self) -> Iterator[str]:
        from shapefit.errors import counted

        seconds = time.monotonic() - self._started
        failed = f", {self.failed} failed" if self.failed else ""
        yield f"{self.command}: {counted(self.done, self.unit)} in {seconds:.1f} s{failed}"
        if self.note and not self.prints_note:
            yield self.note
        if self.written:
            yield f"wrote {self._files()}"

    def _files(self) -> str:
        folders = {path.parent for path in self.written}
        if len(self.written) > LISTED_FILES and len(folders) == 1 and not self.verbose:
            return f"{len(self.written)} files in {folders.pop().resolve()}"
        return ", ".join(map(_shown, self.written))

    def _progress(self, total: int | None, note: str) -> str:
        known = total is not None and self.done <= total
        reached = f"{self.done} of {total}" if known else f"{self.done}"
        seconds = time.monotonic() - self._started
        words = f"{self.command}: {reached} {self.unit}s, {seconds:.0f} s"
        return f"{words}; {note}" if note else words


def _shown(path: Path) -> str:
    """Return the path as a user would say it: relative to the working directory if inside."""
    if path == Path("-"):
        return "standard output"
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)
