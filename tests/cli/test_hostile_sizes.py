"""Files of strangers that would take the memory of the machine."""

import gzip
import os
import resource
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.testing import assert_array_equal
from shapefit.cli.main import run as shapefit

from shapefit.io import landmark_writer
from shapefit.io.inputs import ALWAYS_FITS, free_memory, read_whole
from shapefit.records import Landmarks

MEGABYTE = 1 << 20


MOST_MEMORY = 300 * MEGABYTE
"""Of a run that refuses a file of a few megabytes."""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


PIECE = bytes(1 << 24)
"""Zero bytes that are deflated at a time."""


def zeros(size: int) -> bytes:
    """Return so many zero bytes, deflated: one piece after a full flush, repeated."""
    stream = zlib.compressobj(9, wbits=-zlib.MAX_WBITS)
    piece = stream.compress(PIECE) + stream.flush(zlib.Z_FULL_FLUSH)
    end = stream.flush()
    header = zlib.compress(b"", 9)[:2]
    checksum = size % ADLER_BASE << 16 | 1
    return header + size // len(PIECE) * piece + end + checksum.to_bytes(4, "big")


ADLER_BASE = 65521
"""The sums of Adler-32 are counted modulo it; those of zeros are 1 and the size."""


BOMB = 3 << 30


@pytest.fixture(scope="module")
def bomb() -> bytes:
    return zeros(BOMB)


INFO = """
import sys
from shapefit.cli.main import run
code = run(sys.argv[1:])
# That of getrusage begins with the peak of the process that started this one.
(line,) = [line for line in open("/proc/self/status") if line.startswith("VmHWM")]
print(int(line.split()[1]) * 1024)
sys.exit(code)
"""


def info(*names: str) -> tuple[int, str, int]:
    """Return the exit code, the message, and the memory of a run on files."""
    command = [sys.executable, "-c", INFO, "info", *names]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    return run.returncode, run.stderr, int(run.stdout.split()[-1])


def check_refused(name: str, text: str) -> None:
    code, said, memory = info(name)
    assert code == 2, said
    assert text in said
    assert memory < MOST_MEMORY


def open_images(name: str) -> h5py.File:
    """Return a file of three images, to be written to."""
    images = Landmarks(
        np.ones((3, 4, 2)), landmark_names=tuple("abcd"), items=tuple("xyz"), unit="px"
    )
    with landmark_writer(Path(name)) as writer:
        writer.append(images)
    return h5py.File(name, "r+")


def put_chunk(file: h5py.File, name: str, chunk: bytes, **keys) -> None:
    """Write a dataset anew, of one compressed chunk that is given."""
    shape = file[name].shape
    dtype = file[name].dtype
    del file[name]
    keys = {"chunks": shape, "compression": "gzip", **keys}
    dataset = file.create_dataset(name, shape, dtype, **keys)
    dataset.id.write_direct_chunk((0,) * len(shape), chunk)


TRC = """PathFileType\t4\t(X/Y/Z)\ta.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits
30\t30\t1\t2\tm
Frame#\tTime\ta\t\t\tb\t\t
\t\tX1\tY1\tZ1\tX2\tY2\tZ2
1\t0\t0\t0\t1\t1\t2\t3
"""


BVH = """HIERARCHY
ROOT hip
{
OFFSET 0 0 0
CHANNELS 3 Xrotation Yrotation Zrotation
End Site
{
OFFSET 1 2 3
}
}
MOTION
Frames: 1
Frame Time: 0.04
1 2 3
"""


TEXTS = {
    "table.csv.gz": "item,landmark,x,y\n",
    "wide.csv.gz": "image,a_x,a_y,b_x,b_y\n",
    "long.csv.gz": "image;landmark;x;y\n",
    "dlc.csv.gz": "scorer,s,s,s\nbodyparts,a,a,a\ncoords,x,y,likelihood\n",
    "marks.trc.gz": TRC,
    "walk.bvh.gz": BVH,
    "shapes.tps.gz": "LM=2\n1 2\n3 4\nID=a\n",
}
"""How texts of several readers begin."""


@pytest.mark.parametrize("name", ["landmarks", "item"])
def test_a_chunk_that_holds_more_than_it_declares(bomb, name):
    with open_images("images.h5") as file:
        put_chunk(file, name, bomb)
    assert Path("images.h5").stat().st_size < 4 * MEGABYTE
    check_refused("images.h5", "holds more than the")


def test_a_chunk_behind_a_checksum(bomb):
    with open_images("images.h5") as file:
        put_chunk(file, "landmarks", bomb + b"sums", fletcher32=True)
    check_refused("images.h5", "holds more than the")


def test_a_chunk_that_declares_all_that(bomb):
    keys = {"chunks": (BOMB // 64, 4, 2), "maxshape": (None, 4, 2)}
    with open_images("images.h5") as file:
        put_chunk(file, "landmarks", bomb, **keys)
    check_refused("images.h5", "has chunks of 3.22 GB, and the file holds")


def test_what_is_compressed_twice():
    with open_images("images.h5") as file:
        shape = file["landmarks"].shape
        del file["landmarks"]
        properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        properties.set_chunk(shape)
        for _ in range(2):
            properties.set_filter(1, h5py.h5z.FLAG_OPTIONAL, (9,))
        space = h5py.h5s.create_simple(shape)
        kind = h5py.h5t.NATIVE_DOUBLE
        made = h5py.h5d.create(file.id, b"landmarks", kind, space, properties)
        h5py.Dataset(made)[...] = 0.0
    check_refused("images.h5", "is compressed more than once")


@pytest.mark.parametrize("compression", ["gzip", "lzf", None])
@pytest.mark.parametrize("checked", [True, False])
def test_honest_chunks_are_read(rng, compression, checked):
    """Among them one that is large enough to be looked at."""
    points = rng.normal(size=(40_000, 4, 2)).round(3)
    items = np.array([b"i%d" % number for number in range(len(points))])
    keys = {"compression": compression, "fletcher32": checked}
    with open_images("images.h5") as file:
        for name, values in (("item", items), ("landmarks", points)):
            del file[name]
            file.create_dataset(name, data=values, chunks=values.shape, **keys)
    assert shapefit(["convert", "images.h5", "-o", "again.h5", "-q"]) == 0
    with h5py.File("again.h5") as file:
        assert_array_equal(file["landmarks"], points)


EMPTY_ROWS = [(name, ",,,,\n") for name in TEXTS]


ENDS_OF_WIDE = [("wide.csv.gz", end) for end in ("\n", "\r\n", "  \n", '""\n')]


ENDS_OF_LONG = [("table.csv.gz", end) for end in ("\n", "\r\n", "  \n")]


SLOW_TO_PACK = pytest.param(zipfile.ZIP_LZMA, marks=pytest.mark.slow)


@pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, SLOW_TO_PACK])
def test_arrays_that_inflate(method):
    header = {"descr": "<f8", "fortran_order": False, "shape": (2**20, 24, 2)}
    with (
        zipfile.ZipFile("arrays.npz", "w", method) as archive,
        archive.open("landmarks.npy", "w", force_zip64=True) as member,
    ):
        np.lib.format.write_array_header_1_0(member, header)
        for _ in range(24):
            member.write(bytes(1 << 24))
    check_refused("arrays.npz", "become 403 MB or more")


LINE_ENDS = [("table.csv.gz", "\n"), ("wide.csv.gz", "\r\n")]
"""What the quick tests take of them."""

FURTHER_LINE_ENDS = [
    pytest.param(name, end, marks=pytest.mark.slow)
    for name, end in EMPTY_ROWS + ENDS_OF_WIDE + ENDS_OF_LONG
    if (name, end) not in LINE_ENDS
]


@pytest.mark.parametrize(("name", "end"), LINE_ENDS + FURTHER_LINE_ENDS)
def test_a_text_of_line_ends(name, end):
    """As many as a packed file may hold without a question."""
    count = (60 << 20) // len(end)
    with gzip.open(name, "wb") as file:
        file.write(TEXTS[name].encode())
        file.write(end.encode() * count)
    code, said, memory = info(name)
    assert code in (0, 2), said
    assert memory < MOST_MEMORY


INFLATING = [
    ("table.csv.gz", "item,landmark,x,y\n", "\n"),
    ("wide.csv.gz", "image,a_x,a_y,b_x,b_y\n", "\r\n"),
    ("frames.json.gz", "[0", ",0"),
]
"""A file, how its text begins, and what it repeats."""


@pytest.mark.parametrize(("name", "begin", "piece"), INFLATING)
def test_text_that_inflates(name, begin, piece):
    """To 3 GB, of 3 MB."""
    path = Path(name)
    text = piece.encode() * ((1 << 24) // len(piece))
    member = gzip.compress(text)
    count = BOMB >> 24
    path.write_bytes(gzip.compress(begin.encode()) + count * member)
    assert path.stat().st_size < 4 * MEGABYTE
    check_refused(name, "become")


def test_honest_text_is_unpacked(rng):
    """More than is read without a question."""
    path = Path("numbers.csv.gz")
    rows = "\n".join(map(str, rng.normal(size=50_000).round(6)))
    text = 160 * rows.encode()
    path.write_bytes(gzip.compress(text, compresslevel=1))
    assert len(text) > ALWAYS_FITS
    assert read_whole(path) == text


def test_free_memory_is_below_that_of_the_machine():
    total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    assert 0 < free_memory() < total


def test_free_memory_is_below_that_of_a_process():
    script = "from shapefit.io.inputs import free_memory; print(free_memory())"
    limit = 2 << 30

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))

    command = [sys.executable, "-c", script]
    run = subprocess.run(command, capture_output=True, preexec_fn=limited)
    assert 0 < int(run.stdout) < limit
