"""A fit on a Dask cluster: the same bits as in one process, whoever is killed meanwhile."""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from shapefit.config import load_config
from shapefit.errors import InputError
from shapefit.pipelines.parts import cluster as module
from shapefit.pipelines.parts.part import Done, Job
from shapefit.pipelines.parts.plan import Part
from tests.pipelines.parts.made import make_dictionary, make_images

pytestmark = pytest.mark.slow

BIN = Path(sys.executable).parent
PARTS, SIZE = 10, 64
SLOW = ("--set", "method=alternate", "--set", "alternation.views=1000")
LIMIT = 60
ROOM = 20_000
"""Bytes that a worker without room can write to a file; results are longer."""


@dataclass(frozen=True)
class Cluster:
    """A scheduler on loopback and its workers, which a test may kill."""

    address: str
    file: Path
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    """A folder with a dictionary, landmarks, and their result in one run."""
    folder = tmp_path_factory.mktemp("cluster")
    rng = np.random.default_rng(0)
    make_dictionary(folder / "dict.h5", rng)
    make_images(folder / "views.h5", rng.normal(size=(PARTS * SIZE, 2, 8)))
    done = fit(folder, "whole.h5")
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def cluster(data) -> Iterator[Cluster]:
    with started(data / "shared") as own:
        yield own


@contextmanager
def started(folder: Path) -> Iterator[Cluster]:
    """Start a scheduler and two workers; stop them in the end."""
    folder.mkdir()
    file = folder / "scheduler.json"
    host = ("--host", "127.0.0.1", "--no-dashboard")
    scheduler = dask("scheduler", *host, "--port", "0", "--scheduler-file", file)
    workers: list[subprocess.Popen[bytes]] = []
    try:
        until(lambda: file.exists() and file.stat().st_size > 0, scheduler)
        address = json.loads(file.read_text())["address"]
        cluster = Cluster(address, file, scheduler, workers)
        workers += [start_worker(cluster), start_worker(cluster)]
        yield cluster
    finally:
        for process in (*workers, scheduler):
            process.kill()
            process.wait()


def start_worker(
    cluster: Cluster, prepare: Callable[[], None] | None = None
) -> subprocess.Popen[bytes]:
    """Start a worker of one thread, which is one process: no nanny starts it again."""
    options = ("--nthreads", "1", "--no-nanny", "--host", "127.0.0.1", "--no-dashboard")
    folder = ("--local-directory", cluster.file.parent)
    return dask("worker", cluster.address, *options, *folder, prepare=prepare)


def replace_worker(cluster: Cluster, prepare: Callable[[], None] | None = None) -> None:
    """Start another worker in the place of the last, and wait until all are there."""
    from distributed import Client

    worker = cluster.workers.pop()
    worker.kill()
    worker.wait()
    cluster.workers.append(start_worker(cluster, prepare))
    with Client(cluster.address) as client:
        wanted = {each.pid for each in cluster.workers}
        until(lambda: set(client.run(os.getpid).values()) == wanted, cluster.workers[-1])


def dask(*arguments: object, prepare: Callable[[], None] | None = None) -> subprocess.Popen[bytes]:
    quiet = subprocess.DEVNULL
    words = [BIN / "dask", *map(str, arguments)]
    return subprocess.Popen(words, stdout=quiet, stderr=quiet, preexec_fn=prepare)


def until(holds: Callable[[], bool], process: subprocess.Popen[bytes]) -> None:
    """Wait for something that a process does."""
    ends = time.monotonic() + LIMIT
    while not holds():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < ends
        time.sleep(0.02)


def command(output: str, *options: object) -> list[str]:
    sizes = ("--set", f"partition={SIZE}") if output.endswith("/") else ()
    words = (BIN / "shapefit", "fit", "views.h5", "-d", "dict.h5", "-o", output, *SLOW, *sizes)
    return [*map(str, words), *map(str, options)]


def fit(folder: Path, output: str, *options: object) -> subprocess.CompletedProcess[str]:
    """Run fit to its end."""
    words = command(output, *options)
    return subprocess.run(
        words, cwd=folder, capture_output=True, text=True, timeout=LIMIT, check=False
    )


@contextmanager
def in_the_middle(folder: Path, output: str, *options: object) -> Iterator[subprocess.Popen[bytes]]:
    """Start fit, and wait until some parts are done."""
    pipe = subprocess.PIPE
    process = subprocess.Popen(command(output, *options), cwd=folder, stdout=pipe, stderr=pipe)
    try:
        until(lambda: len(results(folder / output)) >= 2, process)
        yield process
    finally:
        process.kill()
        process.communicate()


def results(folder: Path) -> list[Path]:
    return sorted(folder.glob("part-*.h5"))


def listed(folder: Path) -> Sequence[str]:
    return [part["file"] for part in json.loads((folder / "manifest.json").read_text())["parts"]]


def same_bits(data: Path, output: str) -> None:
    """Fail unless the parts together are the result of one run, and nothing else is there."""
    parts = results(data / output)
    assert [part.name for part in parts] == listed(data / output)
    assert len(parts) == PARTS
    others = {path.name for path in (data / output).iterdir()} - {part.name for part in parts}
    assert others == {"manifest.json", ".lock"}
    with h5py.File(data / "whole.h5") as whole:
        names = [n for n, each in whole.items() if each.shape[:1] == (PARTS * SIZE,)]
        assert {"item", "shapes", "coefficients", "objective"} <= set(names)
        for name in names:
            pieces = []
            for part in parts:
                with h5py.File(part) as file:
                    pieces.append(file[name][:])
            np.testing.assert_array_equal(np.concatenate(pieces), whole[name][:], err_msg=name)


@pytest.mark.parametrize("by", ["--scheduler", "--scheduler-file", "environment"])
def test_a_running_cluster(data, cluster, by, monkeypatch):
    options = {
        "--scheduler": (by, cluster.address),
        "--scheduler-file": (by, cluster.file),
        "environment": (),
    }
    if by == "environment":
        monkeypatch.setenv("DASK_SCHEDULER_ADDRESS", cluster.address)
    output = f"by{by}/"
    done = fit(data, output, *options[by])
    assert done.returncode == 0, done.stderr
    assert "Dask: 2 workers" in done.stderr
    same_bits(data, output)


def test_what_is_assumed_of_the_camera_is_the_same_for_all_parts(project, data, cluster):
    """Two folders of one recording on workers, and in one run: the same bits."""
    frames = sorted((project / "sample_data/openpose").glob("*.json"))
    for name, some in (("early", frames[:18]), ("late", frames[18:])):
        (data / name).mkdir()
        for frame in some:
            (data / name / frame.name).write_bytes(frame.read_bytes())
    line = [str(BIN / "shapefit"), "fit", "early", "late", "-d", "people"]
    line += ["--set", "keypoints=body_25", "--set", "method=posterior"]
    for more in (
        ("-o", "walkers.h5"),
        ("-o", "walkers/", "--set", "partition=10", "--scheduler", cluster.address),
    ):
        told = subprocess.run([*line, *more], cwd=data, capture_output=True, text=True, check=False)
        assert told.returncode == 0, told.stderr
        assert "focal length 1408 px assumed" in told.stderr
    whole = shapes_by_item([data / "walkers.h5"])
    parts = shapes_by_item(results(data / "walkers"))
    assert whole.keys() == parts.keys()
    assert len(results(data / "walkers")) == 2
    for item, shape in whole.items():
        np.testing.assert_array_equal(parts[item], shape)


def shapes_by_item(paths: Sequence[Path]) -> dict[bytes, np.ndarray]:
    found: dict[bytes, np.ndarray] = {}
    for path in paths:
        with h5py.File(path) as file:
            found |= dict(zip(file["item"][:], file["shapes"][:], strict=True))
    return found


def test_a_killed_worker(data, cluster):
    with in_the_middle(data, "worker/", "--scheduler", cluster.address) as process:
        assert len(results(data / "worker")) < PARTS - 2
        cluster.workers[0].send_signal(signal.SIGKILL)
        _, told = process.communicate(timeout=LIMIT)
        assert process.returncode == 0, told
    cluster.workers[0].wait()
    cluster.workers[0] = start_worker(cluster)
    same_bits(data, "worker/")


def test_a_killed_client(data, cluster):
    with in_the_middle(data, "client/", "--scheduler", cluster.address) as process:
        process.send_signal(signal.SIGKILL)
        process.wait()
    time.sleep(1)  # its workers notice
    there = results(data / "client")
    assert 2 <= len(there) < PARTS
    for path in there:
        with h5py.File(path) as file:  # whole
            assert len(file["item"]) == SIZE
    missing = f"part-{PARTS - 1:05}"
    litter = data / "client" / f".{missing}-0123abcd.partial.h5"
    litter.write_bytes(b"left by a killed worker")
    before = listed(data / "client") if (data / "client/manifest.json").exists() else []
    stamps = {name: (data / "client" / name).stat().st_mtime_ns for name in before}
    done = fit(data, "client/", "--scheduler", cluster.address)
    assert done.returncode == 0, done.stderr
    assert f"fit: {(PARTS - len(before)) * SIZE} images" in done.stderr
    for name, stamp in stamps.items():
        assert (data / "client" / name).stat().st_mtime_ns == stamp
    same_bits(data, "client/")


def no_room() -> None:
    """Let this process write no file as long as a result, as on a disk that is almost full."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (ROOM, ROOM))


def test_parts_of_a_worker_without_room_go_to_another(data, cluster):
    replace_worker(cluster, no_room)
    done = fit(data, "full/", "--scheduler", cluster.address)
    assert done.returncode == 0, done.stderr
    same_bits(data, "full/")
    replace_worker(cluster)


def test_workers_without_room(data):
    with started(data / "crowded") as own:
        own.workers.pop().kill()
        replace_worker(own, no_room)
        done = fit(data, "crowded/out/", "--scheduler", own.address)
        lost = [line for line in done.stderr.splitlines() if line.startswith("Failed: ")]
        assert done.returncode == 1, done.stderr
        assert len(lost) == PARTS
        for line in lost:
            assert "File too large; free some space or choose another disk" in line
        assert not results(data / "crowded/out")
        replace_worker(own)
        done = fit(data, "crowded/out/", "--scheduler", own.address)
        assert done.returncode == 0, done.stderr
    same_bits(data, "crowded/out/")


def test_a_killed_scheduler(data):
    with started(data / "doomed") as own:
        with in_the_middle(data, "scheduler/", "--scheduler", own.address) as process:
            own.scheduler.send_signal(signal.SIGKILL)
            _, told = process.communicate(timeout=LIMIT)
        lines = told.decode().splitlines()
        assert process.returncode == 2, told
        assert lines[-1].startswith(f"Error: {own.address}: the scheduler is gone"), told
        assert not any("distributed" in line for line in lines), told
    before = listed(data / "scheduler")
    assert len(before) < PARTS
    done = fit(data, "scheduler/")
    assert done.returncode == 0, done.stderr
    assert f"fit: {(PARTS - len(before)) * SIZE} images" in done.stderr
    same_bits(data, "scheduler/")


def test_no_scheduler_at_the_address(data):
    done = fit(data, "nobody/", "--scheduler", "tcp://127.0.0.1:9")
    assert done.returncode == 2
    assert done.stderr.startswith("Error: tcp://127.0.0.1:9: no scheduler answers")
    assert not results(data / "nobody")


def test_a_file_that_is_not_of_a_scheduler(data):
    (data / "empty.json").write_text("{}")
    done = fit(data, "nobody/", "--scheduler-file", "empty.json")
    assert done.returncode == 2, done.stderr
    assert "empty.json: is not the file of a Dask scheduler" in done.stderr


def test_without_dask(data):
    code = (
        "import sys; sys.modules['distributed'] = None; sys.modules['dask'] = None\n"
        "from shapefit.cli.main import run; sys.exit(run(sys.argv[1:]))"
    )
    words = [sys.executable, "-c", code, *command("none/", "--scheduler", "tcp://127.0.0.1:9")[1:]]
    done = subprocess.run(words, cwd=data, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "pip install distributed" in done.stderr


@pytest.fixture
def job(data) -> Job:
    arguments = {"landmarks": (data / "views.h5",), "dictionary": data / "dict.h5"}
    config = load_config("fit", None, (), {**arguments, "output": f"{data}/direct/"})
    return Job(Part(7, (data / "views.h5",), None, ()), config, data / "direct")


@pytest.mark.parametrize(("bad", "error"), [(2, None), (9, "OSError: busy")])
def test_a_part_that_fails_is_tried_three_times(cluster, job, tmp_path, monkeypatch, bad, error):
    from distributed import Client

    tries = tmp_path / "tries"

    def raises(one: Job) -> Done:
        with tries.open("a") as file:
            file.write(".")
            number = file.tell()
        if number <= bad:
            return Done(one.part, error="OSError: busy", passing=True)
        return Done(one.part)

    monkeypatch.setattr(module, "fit_part", raises)
    with Client(cluster.address) as client:
        (done,) = module.on_cluster(client, deque([job]))
    assert (done.part, done.error) == (job.part, error)
    assert tries.read_text() == "..."


def test_a_part_that_kills_its_workers_is_named(job):
    from distributed.scheduler import KilledWorker

    done = module.failed(job, KilledWorker("fit_part-1", None, 3))
    assert done.part.file == "part-00007.h5"
    assert done.error is not None
    assert done.error.startswith("4 workers died of it")


def test_a_worker_of_another_version_ends_the_run(cluster, job):
    from distributed import Client

    with (
        Client(cluster.address) as client,
        pytest.raises(InputError, match=r"is a worker with shapefit .*, but `fit` is version 0\.0"),
    ):
        list(module.on_cluster(client, deque([replace(job, version="0.0")])))


def test_workers_without_shapefit_end_the_run():
    error = ModuleNotFoundError("No module named 'shapefit'", name="shapefit")
    with pytest.raises(InputError, match="its workers cannot import shapefit; install"):
        module._check_worker(error, "tcp://host:8786")
