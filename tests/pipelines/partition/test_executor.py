"""Parts on processes of this machine, or slowly on Dask: the bits of one run, whoever
is killed.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from shapefit.config import load_config
from shapefit.config.paths import ResultFolder
from shapefit.errors import InputError
from shapefit.pipelines.partition.manifest import Part
from shapefit.pipelines.partition.run import Job, await_job, find_parts, run_jobs
from tests.cli.conftest import run_in
from tests.pipelines.partition.made import entries, make_dictionary, make_images
from tests.pipelines.partition.made import same_bits as same_results

BIN = Path(sys.executable).parent
PARTS, SIZE = 8, 1024
LIMIT = 120


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Path:
    """A folder with a dictionary, landmarks, and their result in one run."""
    folder = tmp_path_factory.mktemp("cluster")
    rng = np.random.default_rng(0)
    make_dictionary(folder / "dict.h5", rng)
    make_images(folder / "views.h5", rng.normal(size=(PARTS * SIZE, 2, 8)))
    fit(folder, "whole.h5")
    return folder


def command(output: str, *options: object) -> list[str]:
    sizes = ("--partition", SIZE) if output.endswith("/") else ()
    line = ("fit", "views.h5", "-d", "dict.h5", "-o", output, "--method", "alternate")
    return [*map(str, (BIN / "shapefit", *line, *sizes, *options))]


def fit(folder: Path, output: str, *options: object) -> str:
    """Run fit to its end, in this process; return what it reports."""
    done = run_in(folder, *command(output, *options)[1:])
    assert done.returncode == 0, done.stderr
    return done.stderr


@contextmanager
def in_the_middle(
    folder: Path, output: str, *options: object
) -> Iterator[subprocess.Popen[bytes]]:
    """Start fit, and wait until a part is done and listed."""
    manifest = folder / output / "manifest.jsonl"
    process = subprocess.Popen(
        command(output, *options),
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        # undo what a shell does to jobs in the background, these tests among them
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        ends = time.monotonic() + LIMIT
        while not manifest.is_file() or manifest.read_bytes().count(b"\n") < 2:
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < ends
            time.sleep(0.02)
        yield process
    finally:
        process.kill()
        process.communicate()


def results(folder: Path) -> list[Path]:
    return sorted(folder.glob("part-*.h5"))


def listed(folder: Path) -> Sequence[str]:
    return [entry["file"] for entry in entries(folder)]


def same_bits(data: Path, output: str) -> None:
    """Fail unless the parts together are the result of one run, but for temporaries of
    the dead.
    """
    parts = results(data / output)
    assert [part.name for part in parts] == listed(data / output)
    assert len(parts) == PARTS
    others = {path.name for path in (data / output).iterdir()} - {
        part.name for part in parts
    }
    assert {name for name in others if ".partial" not in name} == {
        "manifest.jsonl",
    }
    same_results(parts, data / "whole.h5")


def goes_on(data: Path, output: str, *options: object) -> None:
    """Fail unless a run that was ended does the parts that are missing, and no
    other.
    """
    before = listed(data / output)
    assert 1 <= len(before) < PARTS
    assert f"{(PARTS - len(before)) * SIZE:,} images" in fit(data, output, *options)
    same_bits(data, output)


def children(pid: int) -> list[int]:
    """Processes that a process started."""
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text()
    return [int(word) for word in text.split()]


@pytest.fixture
def job(data) -> Job:
    arguments = {"landmarks": (data / "views.h5",), "output": f"{data}/direct/"}
    part = Part("part-00007.h5", (data / "views.h5",), None, ((0, 0),))
    return Job(part, load_config("fit", None, (), arguments), data / "direct")


class TestProcesses:
    def test_the_bits_of_one_run_and_nothing_is_left(self, data, tmp_path, monkeypatch):
        monkeypatch.setenv("TMPDIR", str(tmp_path))
        assert f"{PARTS} of {PARTS} parts done" in fit(data, "two/", "--workers", 2)
        same_bits(data, "two/")
        assert not list(tmp_path.iterdir())

    @pytest.mark.slow
    def test_a_killed_process_is_replaced(self, data):
        with in_the_middle(data, "worker/", "--workers", 2) as process:
            os.kill(children(process.pid)[-1], signal.SIGKILL)
            _, said = process.communicate(timeout=LIMIT)
            assert process.returncode == 0, said
        same_bits(data, "worker/")

    @pytest.mark.parametrize("by", [signal.SIGKILL, signal.SIGINT])
    def test_a_run_that_was_ended_goes_on(self, data, by):
        output = f"ended-{by.name}/"
        with in_the_middle(data, output, "--workers", 2) as process:
            process.send_signal(
                signal.SIGSTOP
            )  # looking for its children takes a while
            workers = children(process.pid)
            process.send_signal(by)
            process.send_signal(signal.SIGCONT)
            process.wait(timeout=LIMIT)
        end = time.monotonic() + 10
        while (
            any(Path(f"/proc/{pid}").exists() for pid in workers)
            and time.monotonic() < end
        ):
            time.sleep(0.05)
        assert not any(Path(f"/proc/{pid}").exists() for pid in workers)
        goes_on(data, output)

    def test_a_part_that_kills_its_process_is_named(self, data, monkeypatch, tmp_path):
        """The others are done, although they were under way when the processes died."""
        (tmp_path / "sitecustomize.py").write_text(
            "import os, sys\n"
            "def hook(event, args):\n"
            "    if event == 'os.rename' and 'part-00001' in str(args[1]):\n"
            "        os._exit(9)\n"
            "sys.addaudithook(hook)\n"
        )
        monkeypatch.setenv("PYTHONPATH", str(tmp_path))
        monkeypatch.chdir(data)
        folder = ResultFolder(Path("deadly").absolute(), partition=SIZE, workers=2)
        arguments = {
            "landmarks": ("views.h5",),
            "dictionary": "dict.h5",
            "output": folder,
        }
        config = load_config("fit", None, ("method=alternate",), arguments)
        Path("deadly").mkdir()
        parts = find_parts(config, SIZE)[:3]
        jobs = deque(Job(part, config, Path("deadly").absolute()) for part in parts)
        entries = {entry.file: entry for entry, _ in run_jobs(jobs, folder)}
        assert [entries[parts[i].file].status for i in (0, 2)] == ["done"] * 2
        assert "its process died, twice" in entries[parts[1].file].error


def test_a_worker_of_another_version_ends_the_run(job):
    with pytest.raises(InputError, match=r"is a worker .* `fit` is version 0\.0"):
        list(run_jobs(deque([job._replace(version="0.0")]), ResultFolder(Path())))


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (
            type("KilledWorker", (Exception,), {})(),
            "one worker after another died of it",
        ),
        (
            ModuleNotFoundError("No module named 'shapefit'"),
            "Dask: No module named 'shapefit'; ",
        ),
        (
            ValueError("not enough values to unpack (expected 3, got 2)"),
            "the scheduler is gone",
        ),
    ],
)
def test_what_dask_raises_is_reported(job, error, text):
    future: Future = Future()
    future.set_exception(error)
    if isinstance(error, ImportError | ValueError):
        with pytest.raises(InputError, match=text):
            await_job(future, job)
    else:
        assert text in await_job(future, job)[0].error


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--scheduler", "tcp://127.0.0.1:9"), "pip install distributed"),
        pytest.param(
            ("--scheduler-file", "empty.json"),
            "no scheduler answers",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_without_a_scheduler(data, monkeypatch, options, text):
    (data / "empty.json").write_text("{}")
    if "pip" in text:
        monkeypatch.setitem(sys.modules, "distributed", None)
    done = run_in(data, *command("none/", *options)[1:])
    assert done.returncode == 2
    assert text in done.stderr
    assert not results(data / "none")


# --- a Dask cluster ---


SOON = 5.0
"""Seconds in which workers learn that a run is gone, and leave its parts."""


def started():
    """Start a scheduler on loopback and two workers of one process each."""
    from distributed import LocalCluster

    keys = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None}
    return LocalCluster(host="127.0.0.1", **keys)


@pytest.fixture(scope="module")
def cluster() -> Iterator:
    with started() as cluster:
        yield cluster


@pytest.mark.slow
@pytest.mark.parametrize("by", ["--scheduler", "--scheduler-file"])
def test_a_running_cluster(data, cluster, by):
    address = cluster.scheduler_address
    if by == "--scheduler-file":
        address = data / "scheduler.json"
        address.write_text(json.dumps({"address": cluster.scheduler_address}))
    fit(data, f"by{by}/", by, address)
    same_bits(data, f"by{by}/")


@pytest.mark.slow
def test_a_killed_worker(data, cluster):
    with in_the_middle(
        data, "killed/", "--scheduler", cluster.scheduler_address
    ) as process:
        os.kill(cluster.workers[0].pid, signal.SIGKILL)
        _, said = process.communicate(timeout=LIMIT)
        assert process.returncode == 0, said
    same_bits(data, "killed/")


@pytest.mark.slow
def test_a_lost_scheduler(data):
    with (
        started() as own,
        in_the_middle(
            data, "scheduler/", "--scheduler", own.scheduler_address
        ) as process,
    ):
        own.close()
        _, said = process.communicate(timeout=LIMIT)
    assert process.returncode == 2, said
    assert "Error: Dask: the scheduler is gone" in said.decode().splitlines()[-1]
    goes_on(data, "scheduler/")


@pytest.mark.slow
def test_a_killed_run_ends_on_its_workers(data, cluster):
    """Parts that take longer than that, of which nothing is left in the folder."""
    address = ("--scheduler", cluster.scheduler_address)
    line = command("killed-run/", "--method", "global", *address)
    process = subprocess.Popen(line, cwd=data, stderr=subprocess.PIPE)
    folder = data / "killed-run"
    ends = time.monotonic() + LIMIT
    while not list(folder.glob(".*.partial.h5")):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < ends
        time.sleep(0.02)
    process.kill()
    process.communicate()
    time.sleep(SOON)
    assert not list(folder.glob("*.h5"))
