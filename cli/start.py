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
    import platform

    vars(platform.uname())["processor"] = ""  # h5py asks, and Python would run `uname` to know
    from .main import main as run_command_line

    try:
        run_command_line()
    except SystemExit as ended:
        _end(ended)


def handle_stopping(handler: Handler) -> None:
    """Have the signals that end a run do something else."""
    for number in STOPPING:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)


def _end(ended: SystemExit) -> NoReturn:
    """End without taking all objects apart one by one, a tenth of the time of one image."""
    import atexit
    import sys

    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    os._exit(ended.code if isinstance(ended.code, int) else 1)


def _leave(number: int, _frame: FrameType | None) -> NoReturn:
    # Raised in the middle of an import, an exception would arrive as something else.
    os._exit(128 + number)
