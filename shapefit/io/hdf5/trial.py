"""Files are opened by a child process first: on damaged ones a library may hang or crash.

The child is forked, so it has the library at hand and costs some milliseconds. In HDF5 it walks
through all that is not numbers: groups, attributes, types, the indices of chunks, the first texts.
"""

from __future__ import annotations

import faulthandler
import gc
import os
import signal
import warnings
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NoReturn

import h5py

import shapefit
from shapefit.errors import input_error
from shapefit.io.memory import in_words
from shapefit.stores.shelf import State, find_state

SECONDS = 5
"""Of the processor that the child may take, and one more for every BYTES_A_SECOND of the file."""
BYTES_A_SECOND = 10_000_000

LONGEST = 300
"""Seconds by the clock, for disks that do not answer."""

MEMORY = 1 << 30
"""Bytes that the child may take, beside what the file itself takes in memory."""

FIRST_TEXTS = 4096
"""Entries that are read of each dataset whose values lie elsewhere in the file."""

NO_MEMORY, NOT_LISTED = 1, 2
"""Exit codes of the child; what a reader will report itself is 0."""

Walk = Callable[[Path], int]
"""Opens a file by a library; returns an exit code of the child."""

DAMAGED = "the file is damaged: copy or make it again"
WRITTEN = "user.shapefit.written"
"""Extended attribute of a file: its size and time of change when this program had written it."""

INSTALLED = Path(shapefit.__file__).parent


def try_opening(
    path: Path, walk: Walk | None = None, library: str = "libhdf5", expands: int = 1
) -> None:
    """Raise InputError for a file on which a library hangs, crashes or fills the memory.

    `walk` opens the file by it and returns an exit code; None walks through HDF5. A sound file
    takes at most `expands` times its size in memory. What the library reports itself is left to
    the reader. A file that did not change is tried once; those that are installed with the package,
    or as this program wrote them, never.
    """
    state = find_state(path)
    if state is None or not hasattr(os, "fork") or _is_known(path, state):
        return
    found = _tried(path, state, walk, library, expands)
    if found is not None:
        raise input_error(path, found, DAMAGED)


_sound: set[tuple[Path, State]] = set()
"""Files that were tried together."""


def try_together(paths: Iterable[Path]) -> None:
    """Let one child walk through several HDF5 files, in a fraction of the time of a child each.

    Where it does not come to its end, each file is tried when it is opened.
    """
    found = ((path, find_state(path)) for path in paths)
    new = [(path, state) for path, state in found if state and not _is_known(path, state)]
    if new and hasattr(os, "fork"):
        sizes = [state[0] for _, state in new]
        seconds, memory = SECONDS + sum(sizes) // BYTES_A_SECOND, MEMORY + max(sizes)
        if _end_of_child(lambda: max(_walk(path) for path, _ in new), seconds, memory) == 0:
            _sound.update(new)


def mark_written(path: Path) -> None:
    """Note on a file that this program wrote it, at this time: as long as it stays so, it is sound.

    It is an attribute of the file beside its content, which copies as a rule do not have; a file
    system without such attributes has the file tried like others.
    """
    state = find_state(path)
    if state is not None and hasattr(os, "setxattr"):
        with suppress(OSError):
            os.setxattr(path, WRITTEN, _words(state))


def _is_known(path: Path, state: State) -> bool:
    """Whether a file is sound without a trial: tried before, installed, or as it was written."""
    if (path, state) in _sound or INSTALLED in path.parents:
        return True
    with suppress(OSError, AttributeError):
        return os.getxattr(path, WRITTEN) == _words(state)
    return False


def _words(state: State) -> bytes:
    return f"{state[0]} {state[1]}".encode()


@lru_cache(maxsize=4096)
def _tried(path: Path, state: State, walk: Walk | None, library: str, expands: int) -> str | None:
    """Let a child walk through the file; return what became of it, None where all was well."""
    seconds, memory = SECONDS + state[0] // BYTES_A_SECOND, MEMORY + expands * state[0]
    code = _end_of_child(partial(walk or _walk, path), seconds, memory)
    if code in (-signal.SIGXCPU, -signal.SIGALRM):
        return f"cannot be read ({library} does not come to an end within {seconds} s)"
    if code == NO_MEMORY:
        return f"cannot be read ({library} asks for more than {in_words(memory)} of memory)"
    if code == NOT_LISTED:
        return "cannot be read (what it holds cannot be listed)"
    return f"cannot be read ({library} crashes: {signal.Signals(-code).name})" if code < 0 else None


def _end_of_child(walk: Callable[[], int], seconds: int, memory: int) -> int:
    """Walk in a child; return its exit code, or the negative number of the signal that ended it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # forks of threads: h5py holds its lock
        # a signal that comes in a fork can be lost
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
        child = os.fork()
    if child == 0:
        _walk_and_exit(walk, seconds, memory)
    try:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    except BaseException:  # a signal that ends this process
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        raise


def _walk_and_exit(walk: Callable[[], int], seconds: int, memory: int) -> NoReturn:
    """Walk in this process, which does nothing else and leaves without unwinding."""
    code = 0
    try:
        gc.disable()
        faulthandler.disable()
        for number in (signal.SIGTERM, signal.SIGALRM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process
        signal.pthread_sigmask(signal.SIG_SETMASK, ())
        signal.alarm(LONGEST + seconds)
        _limit(seconds, memory)
        code = walk()
    except MemoryError:
        code = NO_MEMORY
    finally:
        os._exit(code)


def _limit(seconds: int, memory: int) -> None:
    """Set the limits of this process."""
    import resource

    def lower(what: int, limit: int) -> None:
        soft, hard = resource.getrlimit(what)
        least = limit if soft == resource.RLIM_INFINITY else min(soft, limit)
        resource.setrlimit(what, (least, hard))

    spent = resource.getrusage(resource.RUSAGE_SELF)
    lower(resource.RLIMIT_CPU, int(spent.ru_utime + spent.ru_stime) + seconds)
    lower(resource.RLIMIT_CORE, 0)
    with suppress(OSError):
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        lower(resource.RLIMIT_AS, pages * resource.getpagesize() + memory)


def _walk(path: Path) -> int:
    """Look at all that a file holds; return the exit code."""
    codes = [0]
    with suppress(Exception), h5py.File(path, "r") as file:
        codes.append(_look_at(file["/"]))
        try:
            h5py.h5o.visit(file.id, lambda name: codes.append(_look_at_name(file, name)))
        except Exception as error:
            codes.append(_code(error) or NOT_LISTED)
    return max(codes)


def _look_at_name(file: h5py.File, name: bytes) -> int:
    try:
        return _look_at(file[name])
    except Exception as error:
        return _code(error)


def _look_at(node: Any) -> int:
    """Read what a group or dataset holds beside numbers."""
    try:
        for name in node.attrs:
            node.attrs[name]
        if isinstance(node, h5py.Dataset) and node.shape is not None:
            if node.chunks:
                node.id.get_num_chunks()
            if node.dtype.hasobject:
                node[:FIRST_TEXTS] if node.shape else node[()]
    except Exception as error:
        return _code(error)
    return 0


def _code(error: Exception) -> int:
    return NO_MEMORY if isinstance(error, MemoryError) or "alloc" in str(error) else 0
