"""The command `shapefit`: its commands, and what becomes of every error."""

from __future__ import annotations

import errno
import gc
import os
import signal
import sys
from collections.abc import Sequence
from typing import NoReturn

import click

from shapefit import __version__, log
from shapefit.errors import InputError

from .call import TRACEBACK_VARIABLE
from .commands import COMMANDS
from .demo import demo
from .report import tell
from .signals import Stopped, catch_signals, end_reminders, get_signal, keep_signals

COMPLETION_VARIABLE = "_SHAPEFIT_COMPLETE"

INPUT_ERROR = 2
INTERNAL_ERROR = 3
CLOSED_PIPE = 128 + 13
"""When who reads the output has ended: that of SIGPIPE, which Windows lacks."""


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
First of all, a page from sample data:
  shapefit demo

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

    Each command reads a YAML config; options and --set override it. Messages go to
    stderr, data to files or stdout.
    """


for command in (*COMMANDS, demo):
    commands.add_command(command)


def run(arguments: Sequence[str]) -> int:
    """Run the command line `arguments`; return the exit code, whatever is raised."""
    try:
        code = _run(arguments)
        if sys.stdout is not None:
            sys.stdout.flush()
        return code
    except KeyboardInterrupt:
        return _report_signal(get_signal() or signal.SIGINT)
    except OSError as error:
        if error.errno not in (errno.EPIPE, errno.ENOSPC):
            return _report_internal_error(error)
        # What the stream still holds would be written once more at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if error.errno == errno.EPIPE:
            return CLOSED_PIPE
        tell("Error: standard output: cannot be written: no space is left; free some")
        return INPUT_ERROR
    except Exception as error:
        return _report_internal_error(error)


def _run(arguments: Sequence[str]) -> int:
    """Run the command line; return the exit code, also for errors that users cause."""
    instruction = os.environ.get(COMPLETION_VARIABLE)
    if instruction:
        from click.shell_completion import shell_complete

        from . import completion  # noqa: F401

        return shell_complete(
            commands, {}, "shapefit", COMPLETION_VARIABLE, instruction
        )
    try:
        with (
            keep_signals(),
            commands.make_context("shapefit", list(arguments)) as context,
        ):
            return int(commands.invoke(context))
    except click.exceptions.Exit as exit_:
        return exit_.exit_code
    except click.ClickException as error:
        error.show()
    except InputError as error:
        for problem in error.problems:
            tell(f"Error: {problem}")
    except MemoryError as error:
        fix = "give fewer items at a time, or raise the limit of memory (ulimit -v)"
        tell(
            f"Error: there is not enough memory: {error or 'allocation failed'}; {fix}"
        )
    return INPUT_ERROR


def _report_internal_error(error: Exception) -> int:
    """Report an error as a bug of shapefit; return the exit code."""
    if os.environ.get(TRACEBACK_VARIABLE) == "1":
        import traceback

        sys.stderr.write("".join(traceback.format_exception(error)))
    hint = (
        f"this is a bug in shapefit; --traceback or {TRACEBACK_VARIABLE}=1 shows where"
    )
    text = " ".join(str(error).split())
    tell(f"Internal error: {type(error).__name__}: {text} ({hint})")
    return INTERNAL_ERROR


def _report_signal(number: int) -> int:
    """Say that a signal ended the run; return the exit code."""
    end_reminders()
    word = f"Ended by {signal.Signals(number).name}"
    if number == signal.SIGINT:
        word = "Interrupted"
    tell(f"{word}; no file is left half written.")
    return 128 + number


def main() -> NoReturn:
    """Run the command line of this process, and exit with its exit code."""
    # Threads are the core's. On a busy machine those of BLAS wait for one another: a
    # fit of sequences took 9 times as long with two of them as with one.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # No plugin of pydantic is ours, and to look for some is to read the metadata of
    # every package that is installed.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")
    log.follow_environment()
    gc.disable()  # `Call.follow` enables it: what is imported until then stays
    catch_signals()
    try:
        code = run(sys.argv[1:])
    except Stopped:  # after the command
        code = _report_signal(get_signal() or signal.SIGINT)
    sys.exit(code)
