"""What a command did, summed up from the results of its pipeline, and how far it is."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from shapefit.errors import printable

if TYPE_CHECKING:
    from tqdm import tqdm

    from shapefit.pipelines.result import Counted, Failure, Numbers, Result

MAX_LISTED = 20
"""Failures (and different warnings) that are listed; the rest is counted."""

MAX_FILES = 8
"""Files in one folder that are named; more are counted."""

PAGE_SUFFIX = ".html"
"""Of the file among several that people open."""

LINE_LETTERS = 110
"""Of a line of the summary, its label among them."""

LABEL_LETTERS = 8
"""Of the label before a line of the summary."""

SECONDS_BETWEEN_LINES = 60.0
"""Of the progress where standard error is no terminal, such as a log."""

IMAGES = "image"
"""The unit of commands that count images."""


def tell(text: str) -> None:
    """Write a message to standard error; unprintable characters become escapes."""
    click.echo(printable(text), err=True)


def printable_json(values: object) -> str:
    """Return values as one line of JSON; unprintable characters become escapes."""
    import json

    text = json.dumps(values, ensure_ascii=False, default=str)
    if text.isprintable():
        return text
    return "".join(
        letter if letter.isprintable() else json.dumps(letter)[1:-1] for letter in text
    )


def has_columns() -> bool:
    """Whether standard error is a terminal that a progress bar fits into.

    Some terminals, as of tools that run others, have 0 columns.
    """
    if sys.stderr is None or not sys.stderr.isatty():
        return False
    try:
        return os.get_terminal_size(sys.stderr.fileno()).columns > 0
    except OSError:
        return False


@dataclass(eq=False, repr=False)
class Report:
    """The sum of a pipeline's results; memory does not grow with the number of items.

    `read` names the inputs, and `next_command` is the line to go on with, where the
    pipeline has none. With `to_stdout` the last note is the result of the command, for
    standard output; with `as_json` everything goes there as one object. `reword` puts
    messages into the words of the command line. With more than the share
    `max_untrusted` of items that are not trusted the exit code is 1.
    """

    command: str
    unit: str
    quiet: bool = False
    verbose: bool = False
    to_stdout: bool = False
    as_json: bool = False
    max_untrusted: float | None = None
    read: str = ""
    next_command: str = ""
    reword: Callable[[str], str] = str
    done: int = 0
    failed: int = 0
    total: int | None = None
    note: str = ""
    rows: dict[str, str] = field(default_factory=dict)
    written: list[Path] = field(default_factory=list)
    numbers: Numbers | None = None
    data: Callable[[], object] | None = None
    _failures: list[Failure] = field(default_factory=list)
    _warnings: dict[str, str | Counted] = field(default_factory=dict)
    _untrusted: dict[str, Counted] = field(default_factory=dict)
    _unlisted: int = 0
    _started: float = field(default_factory=time.monotonic)

    def follow(self, results: Iterator[Result]) -> int:
        """Run a pipeline, show its progress and the report; return the exit code."""
        with ExitStack() as stack:
            stack.enter_context(closing(results))  # type: ignore[type-var]
            bar: tqdm | None = None
            if not self.quiet and has_columns():
                from tqdm import tqdm

                bar = stack.enter_context(tqdm(desc=self.command, dynamic_ncols=True))
            shown = time.monotonic()
            is_silent = bar is None and not self.quiet
            for result in results:
                self.add(result)
                if bar is not None:
                    self._advance(bar, result)
                if result.line and not self.quiet:
                    tell(self.reword(result.line))
                elif is_silent and time.monotonic() - shown >= SECONDS_BETWEEN_LINES:
                    shown = time.monotonic()
                    tell(self._progress())
        if self.as_json:
            click.echo(printable_json(self.values()))
            return self.exit_code
        if self.to_stdout:
            click.echo("\n".join(map(printable, self.note.split("\n"))))
        for line in self.lines():
            tell(self.reword(line))
        return self.exit_code

    def _advance(self, bar: tqdm, result: Result) -> None:
        """Advance the progress bar by a result; clear it for the line of the result."""
        bar.total = self.total
        bar.unit = f" {self.unit}"
        note = "" if self.to_stdout else printable(result.note)
        bar.set_postfix_str(note, refresh=False)
        bar.update(result.done)
        if result.line:
            bar.clear()

    def _progress(self) -> str:
        """Return a line on how far the command is, where there is no progress bar."""
        done = f"{self.done:,}"
        if self.total and self.done <= self.total:
            done += f"/{self.total:,}"
        note = f"{self.note}, " if self.note and not self.to_stdout else ""
        return f"{self.command}: {done} {self.unit}s, {note}{self._seconds:.0f} s"

    def add(self, result: Result) -> None:
        """Add the result of one more part of the work to the report."""
        from shapefit.pipelines.result import merge_warnings

        most = sys.maxsize if self.verbose else MAX_LISTED
        self.done += result.done
        self.unit = result.unit or self.unit
        self.failed += len(result.failures)
        self.total = self.total if result.total is None else result.total
        self._failures += result.failures[: most - len(self._failures)]
        self._unlisted += merge_warnings(self._warnings, result.warnings, most)
        reasons = result.reasons
        if not self.verbose:
            reasons = tuple(replace(reason, items=()) for reason in reasons)
        merge_warnings(self._untrusted, reasons)  # type: ignore[arg-type]
        self.written += result.written
        self.note = result.note or self.note
        self.rows |= dict(result.rows)
        self.numbers = result.numbers or self.numbers
        self.data = result.data or self.data

    @property
    def untrusted(self) -> int:
        """Return the number of items that are not to be trusted."""
        return sum(reason.number for reason in self._untrusted.values())

    @property
    def exit_code(self) -> int:
        """Return 0 if there are items, none failed and enough are trusted, else 1."""
        return 1 if self.failed or self.total == 0 or self._has_too_few_trusted else 0

    @property
    def _has_too_few_trusted(self) -> bool:
        """Whether more than the share `max_untrusted` of the items is not trusted."""
        share = self.max_untrusted
        return share is not None and self.untrusted > share * self.done

    def values(self) -> dict[str, object]:
        """Return the report as values of JSON; docs/shell.md describes them."""
        return {
            "command": self.command,
            "unit": self.unit,
            "done": self.done,
            "failed": self.failed,
            "untrusted": {
                reason.text: reason.number for reason in self._untrusted.values()
            },
            "failures": [{"item": f.item, "reason": f.reason} for f in self._failures],
            "warnings": [str(warning) for warning in self._warnings.values()],
            "summary": {
                label.lower(): text for label, text in self._rows().items() if text
            },
            "numbers": self._numbers(),
            "written": [str(path) for path in self.written],
            "seconds": round(self._seconds, 3),
            "data": self.data() if self.data else None,
        }

    def _numbers(self) -> dict[str, object]:
        """Return the numbers of --json, with the same keys for every command."""
        from shapefit.pipelines.result import Numbers

        numbers = self.numbers or Numbers()
        if numbers.images is None and self.unit == IMAGES:
            numbers = numbers._replace(images=self.done)
        camera = numbers.camera and numbers.camera._asdict()
        return {**numbers._asdict(), "failed": self.failed, "camera": camera}

    def lines(self) -> Iterator[str]:
        """Yield the report as lines of text: warnings, failures, then the summary."""
        from shapefit.pipelines.result import Note

        if not self.quiet:
            for warning in self._warnings.values():
                is_note = getattr(warning, "is_note", isinstance(warning, Note))
                yield f"{'Note' if is_note else 'Warning'}: {warning}"
            if self._unlisted:
                yield f"Warning: and {self._unlisted} more"
            for reason in self._untrusted.values():
                yield from (
                    f"Not trusted: {item}: {reason.text}" for item in reason.items
                )
            if self._untrusted:
                reasons = ", ".join(
                    f"{r.number} {r.text}" for r in self._untrusted.values()
                )
                hint = "" if self.verbose else " (-v lists them)"
                number = f"{self.untrusted:,} of {_counted(self.done, self.unit)}"
                yield f"Warning: {number} not trusted: {reasons}{hint}"
        for failure in self._failures:
            yield f"Failed: {failure.item}: {failure.reason}"
        if self.failed > len(self._failures):
            yield f"Failed: and {self.failed - len(self._failures)} more"
        if self._has_too_few_trusted:
            share = self.untrusted / self.done
            yield (
                f"Failed: {share:.0%} are not trusted, more than --fail-untrusted"
                " allows"
            )
        if not self.quiet:
            yield from self._summary()

    def _rows(self) -> dict[str, str]:
        """Return label -> text of the summary: Read, Result, Next and others."""
        note = f", {self.note}" if self.note else ""
        result = _counted(self.done, self.unit) + note
        if self.to_stdout:
            result = "" if self.data else self.note
        return {
            "Read": self.read,
            "Result": result,
            "Next": self.next_command,
        } | self.rows

    def _summary(self) -> Iterator[str]:
        """Yield the lines of the summary, each text after its label."""
        from textwrap import wrap  # which a run with -q need not wait for

        rows = self._rows()
        next_command = rows.pop("Next")
        failed = f", {self.failed} failed" if self.failed else ""
        rows["Result"] = f"{rows.pop('Result')}{failed}, {self._seconds:.1f} s"
        if self.to_stdout:
            rows = {}
        rows["Wrote"] = self._written_files()
        rows["Details"] = self.note if self.verbose and "Result" in self.rows else ""
        rows["Next"] = "" if self.to_stdout else next_command
        for label, text in rows.items():
            lines = wrap(
                text,
                LINE_LETTERS - LABEL_LETTERS,
                break_long_words=False,
                break_on_hyphens=False,
            )
            if label == "Next" and text:  # a command that is copied is one line
                lines = [text]
            for number, line in enumerate(lines):
                yield f"{'' if number else label:{LABEL_LETTERS}}{line}"

    def _written_files(self) -> str:
        """Return the names of the written files, or the number of many in a folder."""
        folders = {path.parent for path in self.written}
        if len(self.written) > 1 and len(folders) == 1 and Path.cwd() not in folders:
            folder = _typed_path(folders.pop())
            if len(self.written) > MAX_FILES and not self.verbose:
                return self._name_page(folder)
            return f"{folder}/: {', '.join(path.name for path in self.written)}"
        return ", ".join(map(_typed_path, self.written))

    def _name_page(self, folder: str) -> str:
        """Return the HTML page's name, and the number of the other files written."""
        pages = [path.name for path in self.written if path.suffix == PAGE_SUFFIX]
        if len(pages) != 1:
            return f"{len(self.written)} files in {folder}/"
        return f"{folder}/{pages[0]} and {len(self.written) - 1} more files"

    @property
    def _seconds(self) -> float:
        """Return the seconds since the command began."""
        return time.monotonic() - self._started


def _counted(number: int, noun: str) -> str:
    """Return a number with its noun, such as `1 image` or `2,000 images`."""
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def _typed_path(path: Path) -> str:
    """Return the path as a user would type it: relative if in the working directory."""
    if path == Path("-"):
        return "standard output"
    here = Path.cwd()
    return str(path.relative_to(here) if path.is_relative_to(here) else path)
