"""The files that a run has written aside, each with its item: a list in a file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path


class StagedNames:
    """Names and their items, in the order in which they came.

    They are in a file because there may be more of them than should be in memory, and because they
    are asked for only when files move, or two items clash.
    """

    def __init__(self, path: Path) -> None:
        """Begin the list in a new file."""
        self._path = path
        self._file = path.open("x")
        self.empty = True

    def add(self, name: str, item: str) -> None:
        """Append a name; raises OSError where the file cannot grow."""
        self._file.write(json.dumps([name, item]) + "\n")
        self.empty = False

    def __iter__(self) -> Iterator[tuple[str, str]]:
        """Yield name and item; raises OSError as `add` does."""
        self._file.flush()
        return self.left_in(self._path)

    @staticmethod
    def left_in(path: Path) -> Iterator[tuple[str, str]]:
        """Yield name and item of a list in a file; a last line that was cut off is no entry."""
        with path.open() as lines:
            for line in lines:
                if line.endswith("\n"):
                    name, item = json.loads(line)
                    yield name, item

    def close(self) -> None:
        """Let go of the file."""
        with suppress(OSError):  # what does not fit on a full disk, nobody will read
            self._file.close()
