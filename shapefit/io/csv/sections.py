"""Read a CSV file a section at a time: text that ends where a record ends."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from shapefit.errors import input_error
from shapefit.io.sources import read_text_blocks, source_name

BYTE_ORDER_MARK = b"\xef\xbb\xbf"

MOST_BYTES = 1 << 20
"""A section grows to this size where no record ends before; a cell cannot be so long."""


@dataclass(frozen=True)
class Section:
    """Whole records of a CSV file: `data` in UTF-8 and as text, and the line they begin on."""

    data: bytes
    text: str
    line: int

    def __bool__(self) -> bool:
        return bool(self.data)

    def without_header(self) -> Section:
        """Return the section without its first line."""
        header, end, _ = self.data.partition(b"\n")
        start = len(header) + len(end)
        return Section(self.data[start:], self.text.partition("\n")[2], self.line + len(end))


def read_sections(path: Path) -> Iterator[Section]:
    """Yield the text of standard input, a pipe or a file; the first section has the header.

    Lines that end in CR alone, as on old Macs, get the line ends of today. Raises InputError as
    `read_text_blocks` does, and for text that is not UTF-8.
    """
    name = source_name(path)
    line, rest, old = 1, b"", False
    for number, block in enumerate(read_text_blocks(path)):
        if number == 0:
            block = block.removeprefix(BYTE_ORDER_MARK)
            old = b"\r" in block and b"\n" not in block
        elif old and b"\n" in block:
            found = "a line ends in CR alone, others in LF"
            raise input_error(f"{name}:1", found, "end all lines in the same way")
        data = rest + (block.replace(b"\r", b"\n") if old else block)
        end = _end_of_records(data)
        rest = data[end:]
        if end:
            yield _decode(data[:end], line, name)
            line += data.count(b"\n", 0, end)
    if rest or line == 1:
        yield _decode(rest, line, name)


def _end_of_records(data: bytes) -> int:
    """Return where the last whole record ends: after a line end with an even count of quotes."""
    end = data.rfind(b"\n") + 1
    open_quote = data.count(b'"', 0, end) % 2 if b'"' in data else 0
    while open_quote and end:
        before = data.rfind(b"\n", 0, end - 1) + 1
        open_quote ^= data.count(b'"', before, end) % 2
        end = before
    if end or len(data) < MOST_BYTES:
        return end
    return data.rfind(b"\n") + 1 or len(data)


def _decode(data: bytes, line: int, name: str) -> Section:
    fix = "save it as CSV in UTF-8"
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        line += data.count(b"\n", 0, error.start)
        raise input_error(f"{name}:{line}", "is not UTF-8 text", fix) from error
    if "\0" in text:
        line += data.count(b"\n", 0, data.index(b"\0"))
        raise input_error(f"{name}:{line}", "is not text (a zero byte)", fix)
    return Section(data, text, line)
