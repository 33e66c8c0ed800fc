"""Signals that end a command: it unwinds, so that no file is left half written."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

ENDING = [
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if hasattr(signal, name)  # Windows has no SIGHUP
]

SECONDS_BETWEEN_REMINDERS = 0.1
"""Of a signal, whose exception may have been lost, until the command has unwound."""


class Stopped(KeyboardInterrupt):
    """A signal ends the command."""


UNWINDING = (Stopped, GeneratorExit)
"""What is handled while a command unwinds; generators that it leaves are closed."""

_received: list[int] = []


def get_signal() -> int | None:
    """Return the signal that ends this process; None where none has come."""
    return _received[0] if _received else None


def catch_signals() -> None:
    """Let the signals in ENDING raise Stopped, but those ignored already, as by nohup.

    Within a callback of a weak reference, or in a library that takes it for a fault of
    its own, the exception would be lost: it is raised again where nothing unwinds.
    """
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _stop)


@contextmanager
def keep_signals() -> Iterator[None]:
    """Raise Stopped at the end of a `with` block during which a signal came.

    It does so however the block ends: another exception may have been made from the
    signal's, and what the block has done without it is not all.
    """
    try:
        yield
    finally:
        if _received:
            raise Stopped


def end_reminders() -> None:
    """Stop the timer that raises Stopped anew, once the command has unwound."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0)


def _stop(number: int, _frame: FrameType | None) -> None:
    """Raise Stopped at the first signal, and start a timer that raises it anew."""
    if _received:
        return
    _received.append(number)
    sys.unraisablehook = _hide_stopped
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, _stop_again)
        every = SECONDS_BETWEEN_REMINDERS
        signal.setitimer(signal.ITIMER_REAL, every, every)
    raise Stopped


def _stop_again(_number: int, _frame: FrameType | None) -> None:
    """Raise Stopped once more at the timer's signal, unless the command unwinds."""
    handled = sys.exception()
    while handled is not None:
        if isinstance(handled, UNWINDING):
            return
        handled = handled.__context__
    raise Stopped


def _hide_stopped(unraisable: UnraisableHookArgs) -> None:
    """Report an exception that Python cannot raise, as by default, except Stopped."""
    if not isinstance(unraisable.exc_value, Stopped):
        sys.__unraisablehook__(unraisable)
