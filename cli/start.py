"""The entry of the command. Until all is imported, an interruption just ends the process."""

from __future__ import annotations

import os
import signal

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import NoReturn


def main() -> NoReturn:
    """Run the command line of this process."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # no traceback out of an import
    # Threads are the core's. On a busy machine those of BLAS wait for one another: a fit of
    # sequences took 9 times as long with two of them as with one.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import platform

    vars(platform.uname())["processor"] = ""  # h5py asks, and Python would run `uname` to know
    from .main import main as run_command_line

    run_command_line()
