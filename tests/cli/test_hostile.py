"""Files of strangers: names do not reach the terminal raw, and nothing takes the memory
of the machine.
"""

import gzip
import json
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
from shapefit.cli.main import run as shapefit

from shapefit.io import landmark_writer
from shapefit.io.formats import record_writer
from shapefit.io.inputs import ALWAYS_FITS, free_memory, read_whole
from shapefit.io.layout import SHAPES
from shapefit.records import Landmarks, Shapes

MEGABYTE = 1 << 20
MAX_MEMORY = 300 * MEGABYTE
"""Of a run that refuses a file of a few megabytes."""

NASTY = "\x1b]0;title\x07\x9b31m\u202eevil\n"
"""A name that sets title, colour and direction of a terminal, and ends lines."""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def zeros(size: int) -> bytes:
    """Return so many zero bytes, deflated."""
    stream, packed = zlib.compressobj(9), []
    piece = bytes(1 << 24)
    for _ in range(size // len(piece)):
        packed.append(stream.compress(piece))
    return b"".join([*packed, stream.flush()])


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
    assert memory < MAX_MEMORY


def open_images(name: str) -> h5py.File:
    """Return a file of three images, to be written to."""
    images = Landmarks(
        np.ones((3, 2, 4)).swapaxes(1, 2),
        landmark_names=tuple("abcd"),
        items=tuple("xyz"),
        unit="px",
    )
    with landmark_writer(Path(name)) as writer:
        writer.append(images)
    return h5py.File(name, "r+")


def put_chunk(file: h5py.File, name: str, chunk: bytes, **keys) -> None:
    """Write a dataset anew, of one compressed chunk that is given."""
    shape, dtype = file[name].shape, file[name].dtype
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


class TestMemory:
    @pytest.mark.parametrize("name", ["landmarks", "item"])
    def test_a_chunk_that_holds_more_than_it_declares(self, bomb, name):
        with open_images("images.h5") as file:
            put_chunk(file, name, bomb)
        assert Path("images.h5").stat().st_size < 4 * MEGABYTE
        check_refused("images.h5", "holds more than the")

    def test_a_chunk_behind_a_checksum(self, bomb):
        with open_images("images.h5") as file:
            put_chunk(file, "landmarks", bomb + b"sums", fletcher32=True)
        check_refused("images.h5", "holds more than the")

    def test_a_chunk_that_declares_all_that(self, bomb):
        rows = BOMB // 64
        with open_images("images.h5") as file:
            put_chunk(
                file, "landmarks", bomb, chunks=(rows, 4, 2), maxshape=(None, 4, 2)
            )
        check_refused("images.h5", "has chunks of 3.22 GB, and the file holds")

    def test_what_is_compressed_twice(self):
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
    def test_honest_chunks_are_read(self, rng, compression, checked):
        """Among them one that is large enough to be looked at."""
        points = rng.normal(size=(40_000, 4, 2)).round(3)
        keys = {"compression": compression, "fletcher32": checked}
        with open_images("images.h5") as file:
            for name in ("landmarks", "item"):
                del file[name]
            names = np.array([b"i%d" % n for n in range(len(points))])
            file.create_dataset("item", data=names, chunks=names.shape, **keys)
            file.create_dataset("landmarks", data=points, chunks=points.shape, **keys)
        assert shapefit(["convert", "images.h5", "-o", "again.h5", "-q"]) == 0
        with h5py.File("again.h5") as file:
            np.testing.assert_array_equal(file["landmarks"], points)

    @pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA])
    def test_arrays_that_inflate(self, method):
        header = {"descr": "<f8", "fortran_order": False, "shape": (2**20, 24, 2)}
        with (
            zipfile.ZipFile("arrays.npz", "w", method) as archive,
            archive.open("landmarks.npy", "w", force_zip64=True) as member,
        ):
            np.lib.format.write_array_header_1_0(member, header)
            for _ in range(24):
                member.write(bytes(1 << 24))
        check_refused("arrays.npz", "become 403 MB or more")

    @pytest.mark.parametrize(
        ("name", "end"),
        [
            *((name, ",,,,\n") for name in TEXTS),
            *(("wide.csv.gz", end) for end in ("\n", "\r\n", "  \n", '""\n')),
            *(("table.csv.gz", end) for end in ("\n", "\r\n", "  \n")),
        ],
    )
    def test_a_text_of_line_ends(self, name, end):
        """As many as a packed file may hold without a question."""
        with gzip.open(name, "wb") as file:
            file.write(TEXTS[name].encode())
            file.write(end.encode() * ((60 << 20) // len(end)))
        code, said, memory = info(name)
        assert code in (0, 2), said
        assert memory < MAX_MEMORY

    @pytest.mark.parametrize(
        ("name", "begin", "piece"),
        [
            ("table.csv.gz", "item,landmark,x,y\n", "\n"),
            ("wide.csv.gz", "image,a_x,a_y,b_x,b_y\n", "\r\n"),
            ("frames.json.gz", "[0", ",0"),
        ],
    )
    def test_text_that_inflates(self, name, begin, piece):
        """To 3 GB, of 3 MB."""
        with gzip.open(name, "wb") as file:
            file.write(begin.encode())
        packed = Path(name).read_bytes()
        member = gzip.compress(piece.encode() * ((1 << 24) // len(piece)))
        count = BOMB >> 24
        Path(name).write_bytes(packed + count * member)
        assert Path(name).stat().st_size < 4 * MEGABYTE
        check_refused(name, "become")

    def test_honest_text_is_unpacked(self, rng):
        """More than is read without a question."""
        rows = "\n".join(map(str, rng.normal(size=50_000).round(6)))
        text = 160 * rows.encode()
        with gzip.open("numbers.csv.gz", "wb", compresslevel=1) as file:
            file.write(text)
        assert len(text) > ALWAYS_FITS
        assert read_whole(Path("numbers.csv.gz")) == text

    def test_free_memory_is_below_every_limit(self):
        total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        assert 0 < free_memory() < total
        script = "from shapefit.io.inputs import free_memory; print(free_memory())"
        limit = 2 << 30

        def limited() -> None:
            resource.setrlimit(resource.RLIMIT_AS, (limit, limit))

        command = [sys.executable, "-c", script]
        run = subprocess.run(command, capture_output=True, preexec_fn=limited)
        assert 0 < int(run.stdout) < limit


class TestTerminals:
    @pytest.fixture
    def nasty(self) -> None:
        """Images, shapes and an own folder whose names and unit are nasty."""
        names = (NASTY, "b", "c", "d")
        rng = np.random.default_rng(0)
        images = Landmarks(
            rng.normal(size=(3, 2, 4)).swapaxes(1, 2),
            landmark_names=names,
            items=(f"{NASTY}1", "2", "3"),
            sequences=(NASTY, NASTY, "s"),
            unit=NASTY,
        )
        with landmark_writer(Path("images.h5")) as writer:
            writer.append(images)
        shapes = Shapes(
            rng.normal(size=(3, 3, 4)).swapaxes(1, 2),
            landmark_names=names,
            items=images.items,
            unit=NASTY,
        )
        with record_writer(Path("shapes.h5"), SHAPES) as writer:
            writer.append(shapes)
        assert shapefit(["learn-dict", "shapes.h5", "-o", "d.h5", "-q"]) == 0
        command = ["fit", "images.h5", "-d", "d.h5", "-o", f"{NASTY[:9]}.h5", "-q"]
        assert shapefit(command) == 0

    def test_no_command_prints_names_as_they_are(self, nasty, capfd):
        result = f"{NASTY[:9]}.h5"
        for command in (
            ("info", "images.h5", "shapes.h5", "d.h5", result),
            ("info", "images.h5", result, "--json"),
            ("verify", result, "-d", "d.h5"),
            ("verify", result, "-d", "d.h5", "--json"),
            ("eval", result, "--truth", "shapes.h5", "-o", "report"),
            ("fit", "images.h5", "-d", "people", "-o", "x.h5"),
            ("fit", "images.h5", "-d", NASTY, "-o", "x.h5"),
            ("info", f"{NASTY}.csv"),
            ("convert", "images.h5", "-o", f"{NASTY[:9]}.xyz"),
            ("convert", "images.h5", "-o", "x.csv", "--to", NASTY),
            ("fit", "images.h5", f"--{NASTY}"),
            (NASTY,),
        ):
            shapefit(command)
            said = capfd.readouterr()
            for line in [*said.out.split("\n"), *said.err.split("\n")]:
                assert line.isprintable(), command
            if "--json" in command:
                json.loads(said.out)
        for path in Path("report").iterdir():
            if path.suffix in (".html", ".svg"):
                lines = path.read_text().split("\n")
                assert all(line.isprintable() for line in lines), path

    def test_a_tag_of_yaml_is_refused(self, capfd):
        for value in (
            '!!python/object/apply:os.system ["touch ran"]',
            "!!python/name:os.system",
            "!own {a: 1}",
            "!!seq {a: 1}",
            "!!map [1]",
            "!!int [1]",
            "!!set {a}",
            "!!binary aGVsbG8=",
            "[1, !!python/tuple [1]]",
        ):
            assert shapefit(["fit", "x.csv", "--set", f"lambda={value}"]) == 2
            said = capfd.readouterr().err
            assert "the tag !" in said, value
            Path("fit.yaml").write_text(f"lambda: {value}\n")
            assert shapefit(["fit", "x.csv", "-c", "fit.yaml"]) == 2
            assert "fit.yaml:1:" in capfd.readouterr().err
        assert not Path("ran").exists()

    @pytest.mark.parametrize("path", ["/proc/self/mem", "/proc/self/task"])
    def test_what_cannot_be_read(self, path, capfd):
        for command in ("info", "convert"):
            out = ("-o", "x.h5") if command == "convert" else ()
            assert shapefit([command, path, *out]) == 2
            assert f"Error: {path}" in capfd.readouterr().err

    @pytest.mark.parametrize(
        "value", ["focal=1e308", "focal=1e-300", "focal=1e160", "point"]
    )
    def test_a_camera_that_is_none(self, value, capfd, project):
        keys = ["--set", f"camera.{value}", "--image-size", "1000x1000"]
        if value == "point":
            keys = ["--focal", "1000", "--set", "camera.principal_point=[1e308, 0]"]
        views = str(project / "sample_data/people_views.csv")
        assert shapefit(["fit", views, "-d", "people", "-o", "r.h5", *keys]) == 2
        said = capfd.readouterr().err
        assert "which no camera has" in said
        assert "RuntimeWarning" not in said


class TestLongNames:
    @pytest.fixture
    def shapes(self) -> None:
        """Two sequences of people whose names differ at their far ends."""
        with h5py.File("x.h5", "w"):
            pass
        rng = np.random.default_rng(0)
        names = tuple("abcd")
        sequences = ("n" * 5000, "n" * 5000, "n" * 4999 + "m", "é" * 3000)
        items = tuple(f"{name}/{n}" for n, name in enumerate(sequences))
        points = rng.normal(size=(4, 3, 4))
        with record_writer(Path("shapes.h5"), SHAPES) as writer:
            writer.append(
                Shapes(
                    points.swapaxes(1, 2),
                    landmark_names=names,
                    items=items,
                    sequences=sequences,
                    unit="m",
                )
            )

    @pytest.mark.parametrize("to", ["trc", "c3d"])
    def test_are_shortened_with_a_number(self, shapes, to):
        pytest.importorskip("ezc3d" if to == "c3d" else "numpy")
        assert shapefit(["convert", "shapes.h5", "-o", f"walk.{to}", "-q"]) == 0
        files = sorted(path.name for path in Path().glob(f"walk_*.{to}"))
        assert len(files) == 3
        assert all(len(name.encode()) < 250 for name in files)
