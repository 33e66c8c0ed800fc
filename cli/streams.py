"""The standard streams of the process, which a shell may have closed or sent to a full disk."""

from __future__ import annotations

import os
import sys
import traceback

import click

from shapefit.errors import printable


def occupy_closed_streams() -> None:
    """Put the null device in the place of each standard stream that the shell has closed.

    The next file to be opened would otherwise take its number, and get what is meant for the
    stream. In Python a closed stream remains None.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number


def tell(text: str) -> None:
    """Write a line for a human to standard error, if there is anybody to read it.

    Names in it come from files: what is not printable is shown as escapes, and stays one line.
    """
    try:
        click.echo(printable(text), err=True)
    except OSError:
        _discard(sys.stderr.fileno())


def output_fault(error: Exception | None) -> OSError | None:
    """Return why what was written to standard output could not leave, None where it could.

    `error` is what broke the run off, if anything did. After a fault nothing more is written
    there, not even at exit.
    """
    fault = error if isinstance(error, OSError) and _is_from_output(error) else None
    if sys.stdout is None:
        return fault
    try:
        sys.stdout.flush()
    except OSError as unsent:
        fault = fault or unsent
    if fault is not None:
        _discard(sys.stdout.fileno())
    return fault


def _is_from_output(error: OSError) -> bool:
    """Whether a closed pipe, or click writing out a text, raised the error."""
    codes = (frame.f_code for frame, _ in traceback.walk_tb(error.__traceback__))
    return isinstance(error, BrokenPipeError) or click.echo.__code__ in codes


def _discard(number: int) -> None:
    """Send what a stream still holds to the null device."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), number)
