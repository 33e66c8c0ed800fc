"""HDF5: damage is told, and never read in silence."""

import dataclasses
import multiprocessing

import numpy as np
import pytest

from shapefit.errors import InputError
from tests.io.files import READERS, load


@pytest.mark.parametrize("share", [0.05, 0.5, 0.95, 0.999])
def test_a_truncated_file(landmark_file, problems, share):
    data = landmark_file.read_bytes()
    size = int(share * len(data))
    landmark_file.write_bytes(data[:size])
    (line,) = problems(load, landmark_file)
    assert line.startswith(f"{landmark_file}: cannot be read (")
    assert line.endswith("; the file may be cut off or damaged: copy or make it again")


HEADER_SIZE = 2048


def spoil(data: bytes, kind: str, rng: np.random.Generator) -> bytes:
    """Flip a bit, zero a stretch, or put noise there: in the header, or anywhere."""
    spoilt = bytearray(data)
    anywhere = rng.random() < 0.7
    end = len(data) if anywhere else min(len(data), HEADER_SIZE)
    place = int(rng.integers(0, end))
    if kind == "flip":
        bit = int(rng.integers(8))
        spoilt[place] ^= 1 << bit
        return bytes(spoilt)
    size = min(int(rng.integers(1, 64)), len(data) - place)
    stretch = bytes(size) if kind == "zeros" else rng.bytes(size)
    spoilt[place : place + size] = stretch
    if spoilt == data:
        return spoil(data, kind, rng)
    return bytes(spoilt)


WITHOUT_CHECKSUM = {"prior", "maker", "attributes", "provenance", "unit"}
"""Fields that are attributes of a file, or read from such."""


def show_values(record) -> str:
    """Return as a text what a record or dictionary holds in datasets with checksums."""
    named = {}
    for field in dataclasses.fields(record):
        named[field.name] = getattr(record, field.name)
    for name in ("extras", "file_extras"):
        named |= named.pop(name, {})
    shown = {}
    for name, value in named.items():
        if name not in WITHOUT_CHECKSUM:
            shown[name] = value.tolist() if isinstance(value, np.ndarray) else value
    return repr(shown)


@pytest.mark.parametrize("kind", ["flip", "zeros", "noise"])
@pytest.mark.parametrize("name", READERS)
def test_no_damage_to_datasets_is_read_in_silence(request, tmp_path, name, kind):
    path = request.getfixturevalue(f"{name.removesuffix('s')}_file")
    read = READERS[name]
    sound = show_values(read(path))
    data = path.read_bytes()
    rng = np.random.default_rng(len(path.stem) + len(kind))
    spoilt_files = [tmp_path / f"{number}.h5" for number in range(25)]
    for spoilt in spoilt_files:
        spoilt.write_bytes(spoil(data, kind, rng))
    outcomes = read_in_a_process(read, spoilt_files)
    assert set(outcomes) <= {sound, REFUSED}
    assert outcomes.count(REFUSED) >= 12


REFUSED = "refused"


def send_values(read, paths, sender) -> None:
    for path in paths:
        try:
            outcome = show_values(read(path))
        except InputError:
            outcome = REFUSED
        sender.send(outcome)


def read_in_a_process(read, paths) -> list[str]:
    """Return the values of each file, or REFUSED, also where damage lets libhdf5 loop
    for ever.
    """
    fork = multiprocessing.get_context("fork")
    outcomes: list[str] = []
    while len(outcomes) < len(paths):
        receiver, sender = fork.Pipe(duplex=False)
        remaining = paths[len(outcomes) :]
        process = fork.Process(target=send_values, args=(read, remaining, sender))
        process.start()
        sender.close()
        while len(outcomes) < len(paths) and receiver.poll(1):
            outcomes.append(receiver.recv())
        if len(outcomes) < len(paths):
            outcomes.append(REFUSED)  # it loops; the next process goes on behind it
        process.kill()
        process.join()
    return outcomes
