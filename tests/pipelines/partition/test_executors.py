"""Parts on executors: the same bits as in one process, whoever is killed meanwhile.

On processes of this machine, without Dask; and, slowly, on a Dask cluster.
"""

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from shapefit.config import load_config
from shapefit.errors import InputError
from shapefit.pipelines.partition import executors
from shapefit.pipelines.partition.executors import InThisProcess, Job, do_jobs, processes
from shapefit.pipelines.partition.plan import Part, plan_parts
from tests.cli.conftest import run_in
from tests.pipelines.partition.made import entries, make_dictionary, make_images
from tests.pipelines.partition.made import same_bits as same_results

BIN = Path(sys.executable).parent
PARTS, SIZE = 10, 1024
SLOW = ("--set", "method=alternate")
LIMIT = 60
ROOM = 20_000
"""Bytes that a worker without room can write to a file; results are longer."""


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


def hear_interrupts() -> None:
    """Undo what a shell does to jobs in the background, these tests among them."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@contextmanager
def in_the_middle(folder: Path, output: str, *options: object) -> Iterator[subprocess.Popen[bytes]]:
    """Start fit, and wait until some parts are done."""
    pipe = subprocess.PIPE
    process = subprocess.Popen(
        command(output, *options), cwd=folder, stdout=pipe, stderr=pipe, preexec_fn=hear_interrupts
    )
    try:
        until(lambda: len(results(folder / output)) >= 2, process)
        yield process
    finally:
        process.kill()
        process.communicate()


def results(folder: Path) -> list[Path]:
    return sorted(folder.glob("part-*.h5"))


def listed(folder: Path) -> Sequence[str]:
    return [entry["file"] for entry in entries(folder)]


def same_bits(data: Path, output: str) -> None:
    """Fail unless the parts together are the result of one run, and nothing else is there.

    But for what a killed process was writing, which is left.
    """
    parts = results(data / output)
    assert [part.name for part in parts] == listed(data / output)
    assert len(parts) == PARTS
    others = {path.name for path in (data / output).iterdir()} - {part.name for part in parts}
    assert {name for name in others if ".partial" not in name} == {"manifest.jsonl", ".lock"}
    same_results(parts, data / "whole.h5")


@pytest.fixture
def job(data) -> Job:
    arguments = {"landmarks": (data / "views.h5",), "dictionary": data / "dict.h5"}
    config = load_config("fit", None, (), {**arguments, "output": f"{data}/direct/"})
    return Job(Part(7, (data / "views.h5",), None, ()), config, data / "direct")


def test_a_worker_of_another_version_ends_the_run(job):
    with pytest.raises(InputError, match=r"is a worker .* `fit` is version 0\.0"):
        list(do_jobs(deque([replace(job, version="0.0")]), processes, 1))


def children(pid: int) -> list[int]:
    """Processes that a process started."""
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text()
    return [int(word) for word in text.split()]


def listening(pids: list[int]) -> bool:
    """Whether one of these processes listens on a port of TCP."""
    states = Path("/proc/net/tcp").read_text().splitlines()[1:]
    open_ones = {f"socket:[{line.split()[9]}]" for line in states if line.split()[3] == "0A"}
    links = set()
    for each in (each for pid in pids for each in Path(f"/proc/{pid}/fd").iterdir()):
        with suppress(FileNotFoundError):  # a file that was closed while we look
            links.add(os.readlink(each))
    return bool(open_ones & links)


class TestProcesses:
    def test_the_bits_of_one_run_and_nothing_is_left(self, data, tmp_path, monkeypatch):
        monkeypatch.setenv("TMPDIR", str(tmp_path))
        done = fit(data, "two/", "--workers", 2)
        assert done.returncode == 0, done.stderr
        same_bits(data, "two/")
        assert f"{PARTS} of {PARTS} parts done" in done.stderr.splitlines()[-1]
        assert "Dask" not in done.stderr
        assert not list(tmp_path.iterdir())

    def test_a_killed_process_is_replaced_and_no_port_is_open(self, data):
        with in_the_middle(data, "worker/", "--workers", 2) as process:
            own = children(process.pid)
            assert not listening([process.pid, *own])
            os.kill(own[-1], signal.SIGKILL)
            _, told = process.communicate(timeout=LIMIT)
            assert process.returncode == 0, told
        same_bits(data, "worker/")

    @pytest.mark.parametrize("by", [signal.SIGKILL, signal.SIGINT])
    def test_a_run_that_was_ended_goes_on(self, data, by):
        output = f"ended-{by.name}/"
        with in_the_middle(data, output, "--workers", 2) as process:
            process.send_signal(signal.SIGSTOP)  # looking for its children takes a while
            own = children(process.pid)
            process.send_signal(by)
            process.send_signal(signal.SIGCONT)
            process.wait(timeout=LIMIT)
        end = time.monotonic() + 10
        while any(Path(f"/proc/{pid}/stat").exists() for pid in own) and time.monotonic() < end:
            time.sleep(0.05)
        assert not any(Path(f"/proc/{pid}/stat").exists() for pid in own)
        assert 2 <= len(results(data / output)) < PARTS
        before = listed(data / output)
        done = fit(data, output, "--workers", 2)
        assert f"fit: {(PARTS - len(before)) * SIZE} images" in done.stderr
        same_bits(data, output)

    def test_a_part_that_kills_its_process_is_named(self, data, monkeypatch, tmp_path):
        """The others are done, although they were under way when the processes died."""
        (tmp_path / "sitecustomize.py").write_text(
            "import os, sys\n"
            "def hook(event, args):\n"
            "    if event == 'open' and str(args[0]).find('part-00001') >= 0:\n"
            "        os._exit(9)\n"
            "sys.addaudithook(hook)\n"
        )
        monkeypatch.setenv("PYTHONPATH", str(tmp_path))
        monkeypatch.chdir(data)
        arguments = {"landmarks": ("views.h5",), "dictionary": "dict.h5", "output": "deadly/"}
        config = load_config("fit", None, ("method=alternate", f"partition={SIZE}"), arguments)
        Path("deadly").mkdir()
        parts = plan_parts(config)[:3]
        jobs = deque(Job(part, config, Path("deadly").absolute()) for part in parts)
        found = {done.part.file: done.error for done in do_jobs(jobs, processes, 2)}
        assert found[parts[0].file] is found[parts[2].file] is None
        assert "3 processes died of it" in found[parts[1].file]


# --- a Dask cluster ---


@dataclass(frozen=True)
class Cluster:
    """A scheduler on loopback and its workers, which a test may kill."""

    address: str
    file: Path
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]


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


@pytest.mark.slow
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


@pytest.mark.slow
def test_what_is_assumed_of_the_camera_is_the_same_for_all_parts(project, data, cluster):
    """Two folders of one recording on workers, and in one run: the same bits."""
    frames = sorted((project / "sample_data/openpose").glob("*.json"))
    for name, some in (("early", frames[:18]), ("late", frames[18:])):
        (data / name).mkdir()
        for frame in some:
            (data / name / frame.name).write_bytes(frame.read_bytes())
    line = ["fit", "early", "late", "-d", "people", "--set", "keypoints=body_25"]
    line += ["--set", "method=posterior", "--set", "image_size=[1280,720]"]
    for more in (("walkers.h5",), ("walkers/", "--scheduler", cluster.address)):
        told = run_in(data, *line, "-o", *more)
        assert told.returncode == 0, told.stderr
        assert "focal length 1408 px (assumed" in told.stderr
    assert len(results(data / "walkers")) == 2
    same_results(results(data / "walkers"), data / "walkers.h5", {"item", "shapes"})


@pytest.mark.slow
def test_a_killed_worker(data, cluster):
    with in_the_middle(data, "killed/", "--scheduler", cluster.address) as process:
        assert len(results(data / "killed")) < PARTS - 2
        cluster.workers[0].send_signal(signal.SIGKILL)
        cluster.workers[0].wait()
        _, told = process.communicate(timeout=LIMIT)
        assert process.returncode == 0, told
    cluster.workers[0] = start_worker(cluster)
    same_bits(data, "killed/")


@pytest.mark.slow
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
    before = listed(data / "client") if (data / "client/manifest.jsonl").exists() else []
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_killed_scheduler(data):
    with started(data / "doomed") as own:
        with in_the_middle(data, "scheduler/", "--scheduler", own.address) as process:
            own.scheduler.send_signal(signal.SIGKILL)
            _, told = process.communicate(timeout=LIMIT)
        lines = told.decode().splitlines()
        assert process.returncode == 2, told
        assert lines[-1].startswith("Error: Dask: the scheduler is gone"), told
        assert not any("distributed" in line for line in lines), told
    before = listed(data / "scheduler")
    assert len(before) < PARTS
    done = fit(data, "scheduler/")
    assert done.returncode == 0, done.stderr
    assert f"fit: {(PARTS - len(before)) * SIZE} images" in done.stderr
    same_bits(data, "scheduler/")


@pytest.mark.parametrize(("options", "told", "modules"), [
    (("--scheduler", "tcp://127.0.0.1:9"), "pip install distributed", {"distributed": None}),
    pytest.param(
        ("--scheduler", "tcp://127.0.0.1:9"), "Error: tcp://127.0.0.1:9: no scheduler answers", {},
        marks=pytest.mark.slow,
    ),
    pytest.param(
        ("--scheduler-file", "empty.json"), "empty.json: is not the file of a Dask scheduler", {},
        marks=pytest.mark.slow,
    ),
])  # fmt: skip
def test_without_a_scheduler(data, monkeypatch, options, told, modules):
    (data / "empty.json").write_text("{}")
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    done = run_in(data, *command("none/", *options)[1:])
    assert done.returncode == 2
    assert told in done.stderr
    assert not results(data / "none")


@pytest.mark.slow
def test_a_part_that_kills_its_workers_is_named(job):
    from distributed.scheduler import KilledWorker

    killed = KilledWorker("fit_part-1", None, 3)
    for error, text in ((killed, "4 workers died of it"), (ModuleNotFoundError(name="x"), None)):
        future = InThisProcess().submit(lambda: None)
        future._state, future._exception = "FINISHED", error
        if text is None:
            with pytest.raises(ModuleNotFoundError):
                executors.result_of(future, job)
        else:
            assert text in executors.result_of(future, job).error


def test_workers_without_shapefit_end_the_run(job):
    future = InThisProcess().submit(lambda: None)
    future._exception = ModuleNotFoundError("No module named 'shapefit'", name="shapefit")
    with pytest.raises(InputError, match="its workers cannot import shapefit; install"):
        executors.result_of(future, job)
