"""The command `shapefit`: its commands, and what becomes of every error."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType
from typing import NoReturn

import click

from shapefit import __version__
from shapefit.errors import InputError

from .commands import COMMANDS, TRACEBACK_VARIABLE, config_command, make_command
from .streams import occupy_closed_streams, output_fault, tell

COMPLETION_VARIABLE = "_SHAPEFIT_COMPLETE"

INPUT_ERROR = 2
INTERNAL_ERROR = 3
PIPE_CLOSED = 128 + signal.SIGPIPE


@click.group(
    name="shapefit",
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="""\b
Exit codes:
  0  everything succeeded
  1  finished, but some items failed (they are listed), or none was there
  2  bad usage, config or input
  3  internal error (--traceback shows where)

\b
Examples, the whole chain:
  shapefit learn-dict train.h5 -o dict.h5
  shapefit project    test.h5 -o views.h5
  shapefit fit        views.h5 -d dict.h5 -o result.h5
  shapefit eval       result.h5 --truth test.h5 -o report/

\b
Completion in the shell (bash; zsh and fish alike):
  eval "$(_SHAPEFIT_COMPLETE=bash_source shapefit)"
""",
)
@click.version_option(__version__, prog_name="shapefit")
def commands() -> None:
    """Lift 2D landmarks in single images to 3D shapes with a convex program.

    Each command reads a YAML config; options and --set override it. Messages go to stderr, data to
    files or stdout.
    """


for command in (*map(make_command, COMMANDS), config_command):
    commands.add_command(command)


def run(arguments: Sequence[str]) -> int:
    """Run the command line `arguments`; return the exit code."""
    code, error = INTERNAL_ERROR, None
    try:
        code = _run(arguments)
    except KeyboardInterrupt:
        return _stopped(signal.SIGINT)
    except Exception as raised:
        if _signals:  # what the interruption became, in the middle of an import or of C
            return _stopped(_signals[0])
        error = raised
    fault = output_fault(error)
    if isinstance(fault, BrokenPipeError):
        return PIPE_CLOSED
    if fault is not None and code != INPUT_ERROR:
        tell(f"Error: standard output: cannot be written: {fault.strerror}; free some space")
        return INPUT_ERROR
    return code if error is None else _internal_error(error)


def _run(arguments: Sequence[str]) -> int:
    """Run the command line; what a user can cause becomes an exit code, all else is raised."""
    if instruction := os.environ.get(COMPLETION_VARIABLE):
        from click.shell_completion import shell_complete

        return shell_complete(commands, {}, "shapefit", COMPLETION_VARIABLE, instruction)
    try:
        with commands.make_context("shapefit", list(arguments)) as context:
            return int(commands.invoke(context))
    except click.exceptions.Exit as exit_:
        return exit_.exit_code
    except click.ClickException as error:
        error.show()
        return INPUT_ERROR
    except InputError as error:
        for problem in error.problems:
            tell(f"Error: {problem}")
        return INPUT_ERROR
    except UnicodeEncodeError as error:
        fix = "set LC_ALL=C.UTF-8, or take another name"
        tell(f"Error: {error.object!a} is no name of a file in this locale; {fix}")
        return INPUT_ERROR
    except Exception as error:
        from shapefit.errors import lacks_memory

        if not lacks_memory(error):
            raise
        size = f": {error}" if isinstance(error, MemoryError) and str(error) else ""
        fix = "give fewer items at a time, or raise the limit of memory (ulimit -v)"
        tell(f"Error: memory: there is not enough{size}; {fix}")
        return INPUT_ERROR


def _internal_error(error: Exception) -> int:
    if os.environ.get(TRACEBACK_VARIABLE) == "1":
        import traceback

        sys.stderr.write("".join(traceback.format_exception(error)))
    hint = f"this is a bug in shapefit; --traceback or {TRACEBACK_VARIABLE}=1 shows where"
    text = " ".join(str(error).split())
    tell(f"Internal error: {type(error).__name__}: {text} ({hint})")
    return INTERNAL_ERROR


STOPPING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that end a run. One that is ignored, as nohup does with SIGHUP, stays ignored."""

_signals: list[int] = []
"""The signals that came to end this run."""


def _unwind(number: int, _frame: FrameType | None) -> NoReturn:
    _signals.append(number)
    raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(128 + number)


def _stopped(number: int) -> int:
    """Say that a signal ended the run; return the exit code."""
    word = "Interrupted" if number == signal.SIGINT else f"Ended by {signal.Signals(number).name}"
    tell(f"{word}; no file is left half written.")
    return 128 + number


def main() -> NoReturn:
    """Run the command line of this process; signals unwind it, so that no half file is left."""
    # Threads are the core's. On a busy machine those of BLAS wait for one another: a fit of
    # sequences took 9 times as long with two of them as with one.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.disable()  # `run_command` enables it: what is imported until then stays
    occupy_closed_streams()
    handled = [each for each in STOPPING if signal.getsignal(each) is not signal.SIG_IGN]
    for number in handled:
        signal.signal(number, _unwind)
    try:
        code = run(sys.argv[1:])
    except SystemExit:
        code = _stopped(_signals[0])
    for number in handled:
        signal.signal(number, signal.SIG_DFL)  # all is done, and nothing is left to unwind
    sys.exit(code)
