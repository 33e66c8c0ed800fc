"""Many files that appear together: write them aside, then move them into their folder."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path, PurePosixPath

from shapefit.errors import input_error
from shapefit.io.whole.atomic import is_writable, new_folders, shortened, storage_errors
from shapefit.io.whole.held_signals import held_signals
from shapefit.io.whole.litter import lock_new, remove_litter
from shapefit.io.whole.staged_names import StagedNames

NEW, REPLACED, NAMES = "new", "replaced", "names"
"""In the staging folder: the files to come, those that they replaced, and the list of them."""

Write = Callable[[Path], object]


class StagedFiles:
    """Files on their way to `folder`; `stuck` if those they replaced cannot be put back."""

    def __init__(self, folder: Path, staging: Path, hold: ExitStack) -> None:
        """Take a folder to write to, and what will hold back signals once files move."""
        self.folder = folder
        self._staging = staging
        self._new, self._old = staging / NEW, staging / REPLACED
        self._new.mkdir()
        self._names = StagedNames(staging / NAMES)
        self._hold = hold
        self._made: list[Path] = []
        self._published = False
        self.stuck = False

    @property
    def empty(self) -> bool:
        """Whether no file was written."""
        return self._names.empty

    def __contains__(self, name: PurePosixPath) -> bool:
        """Whether folder/name was written, or what the file system takes for the same name."""
        return (self._new / name).exists()

    def write(self, name: PurePosixPath, write: Write, item: str) -> None:
        """Let `write` fill the file of an item that becomes folder/name, its folders included.

        Raises InputError where it cannot be written, where something in the folder is in the way,
        and where a file of another item is: the names of two items may be equal for the
        file system.
        """
        target, path = self.folder / name, self._new / name
        with storage_errors(target, None):
            self._check_clash(path, item)
            check_replaceable(target)
            path.parent.mkdir(parents=True, exist_ok=True)
            write(path)
            self._names.add(str(name), item)

    def publish(self) -> None:
        """Move every file to its place, over the one of an earlier run if there is one.

        What is replaced is kept until the end of `staged_files`, which puts it back on any error.
        So something else can be completed together with the files: publish them, complete it,
        leave. Signals wait until then. Raises InputError, before anything moves, where something
        is in the way.
        """
        if self._published or self.empty:
            return
        with storage_errors(self.folder, None):
            for name, _ in self._names:
                check_replaceable(self.folder / name)
        self._hold.enter_context(held_signals())
        self._published = True
        for name, _ in self._names:
            target = self.folder / name
            with storage_errors(target, None):
                self._make(target.parent)
                _keep(target, self._old / name)
                (self._new / name).replace(target)

    def withdraw(self) -> None:
        """Leave the folder as it was before `publish`.

        Raises InputError where that is not possible; earlier files then stay in `replaced`.
        """
        if not self._published:
            return
        stuck = _put_all_back(self.folder, self._staging, self._names)
        for made in reversed(self._made):
            with suppress(OSError):  # another run may have come to use it
                made.rmdir()
        if stuck is not None:
            self.stuck = True
            found = f"the earlier files in it cannot be put back: {stuck.strerror}"
            raise input_error(self._old, found, f"move them to {self.folder}") from stuck

    def settle(self) -> None:
        """Give up what was replaced: from now on nothing is put back."""
        if self._published and self._old.exists():
            with suppress(OSError):
                self._old.rename(self._staging / "obsolete")

    def close(self) -> None:
        """Let go of the list of files."""
        self._names.close()

    def _make(self, folder: Path) -> None:
        """Make a folder and those around it, and remember which were new."""
        missing = []
        while not folder.exists():
            missing.append(folder)
            folder = folder.parent
        for new in reversed(missing):
            new.mkdir(exist_ok=True)
            self._made.append(new)

    def _check_clash(self, path: Path, item: str) -> None:
        """Raise InputError where a file of this run has the place of another, or of its folder."""
        occupied = next(place for place in (path, *path.parents) if place.exists())
        if occupied != path and occupied.is_dir():
            return
        other = next(item for name, item in self._names if self._lies_at(name, occupied))
        if occupied.is_dir():
            found = f"is a file of the item {item!r} and a folder of the item {other!r}"
        elif occupied != path:
            found = f"is a file of the item {other!r} and a folder of the item {item!r}"
        else:
            found = f"is a file of two items, {other!r} and {item!r}"
        place = self.folder / occupied.relative_to(self._new)
        raise input_error(place, found, "rename one of them, or choose another format")

    def _lies_at(self, name: str, place: Path) -> bool:
        """Whether `place` is that file, or a folder around it, to the file system."""
        around = PurePosixPath(name)
        return any((self._new / part).samefile(place) for part in (around, *around.parents))


def check_replaceable(target: Path) -> None:
    """Raise InputError where no file can be put at `target` although its folders may be made."""
    if target.is_dir():
        fix = "remove or rename it, or choose another folder"
        raise input_error(target, "it is a folder, but must be a file", fix)
    around = next(folder for folder in target.parents if os.path.lexists(folder))
    if not around.is_dir():
        fix = "remove or rename it, or choose another folder"
        raise input_error(around, "it is not a folder, but files must go into it", fix)
    if not is_writable(around):
        fix = "change its permissions, or choose another folder"
        raise input_error(around, "it is not writable, but files must go into it", fix)


@contextmanager
def staged_files(folder: Path) -> Iterator[StagedFiles]:
    """Give files that move into `folder` on `publish` or a clean exit, and are gone on any error.

    They lie in a hidden folder: in `folder` itself, or beside it as long as it does not exist. What
    else the folder holds stays; without files it is not made. The files are not synced one by one,
    which would take most of the time: a power failure, unlike a killed process, may leave empty
    ones. Raises InputError as `StagedFiles` does.
    """
    around = folder if folder.is_dir() else folder.parent
    with new_folders(around), _staged_files(folder, around) as files:
        yield files


@contextmanager
def _staged_files(folder: Path, around: Path) -> Iterator[StagedFiles]:
    start, end = f".{shortened(folder.name)}-", ".partial"
    for place in (folder, folder.parent):
        remove_litter(place, start, end, partial(_undo, folder))
    with storage_errors(folder, None):
        make = partial(tempfile.mkdtemp, end, start, around)
        staging, held = lock_new(lambda: Path(make()))
    # Signals that were held back act when the staging folder is gone.
    with ExitStack() as hold:
        files = None
        try:
            with storage_errors(folder, None):
                files = StagedFiles(folder, staging, hold)
            yield files
            files.publish()
            files.settle()
        except BaseException:
            if files is not None:
                files.withdraw()
            raise
        finally:
            if files is not None:
                files.close()
            if files is None or not files.stuck:
                shutil.rmtree(staging, ignore_errors=True)
            os.close(held)


def _undo(folder: Path, staging: Path) -> None:
    """Remove what a killed run left; where it was moving files, put back those it replaced."""
    if (staging / REPLACED).exists():
        names = StagedNames.left_in(staging / NAMES)
        if _put_all_back(folder, staging, names) is not None:
            return
    shutil.rmtree(staging)


def _put_all_back(folder: Path, staging: Path, names: Iterable[tuple[str, str]]) -> OSError | None:
    """Leave the folder as it was before files of these names moved to it; return what failed."""
    stuck = None
    for name, _ in names:
        target, old = folder / name, staging / REPLACED / name
        try:
            if os.path.lexists(old):
                old.replace(target)
            elif not os.path.lexists(staging / NEW / name):
                target.unlink(missing_ok=True)
        except OSError as error:
            stuck = error
    return stuck


def _keep(target: Path, aside: Path) -> None:
    """Give the file at `target`, if there is one, a second name: it stays until it is replaced."""
    if not os.path.lexists(target):
        return
    aside.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(target, aside, follow_symlinks=False)
    except (OSError, NotImplementedError):  # a system or file system without such links
        target.replace(aside)
