"""The entry of the command: until all is imported, a signal just ends the process.

Nothing is imported here that the signals would have to wait for.
"""

from __future__ import annotations

import os
import signal

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType
    from typing import NoReturn

    Handler = Callable[[int, FrameType | None], object] | signal.Handlers

STOPPING = tuple(
    signal.Signals[name]
    for name in ("SIGINT", "SIGTERM", "SIGHUP")
    if name in signal.Signals.__members__
)
"""Signals that end a run. One that is ignored, as nohup does with SIGHUP, stays ignored."""


def main() -> NoReturn:
    """Run the command line of this process."""
    handle_stopping(_leave)
    # Threads are the core's. On a busy machine those of BLAS wait for one another: a fit of
    # sequences took 9 times as long with two of them as with one.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from .main import main as run_command_line

    run_command_line()


def handle_stopping(handler: Handler) -> None:
    """Have the signals that end a run do something else."""
    for number in STOPPING:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def _leave(number: int, _frame: FrameType | None) -> NoReturn:
    # Raised in the middle of an import, an exception would arrive as something else.
    os._exit(128 + number)
