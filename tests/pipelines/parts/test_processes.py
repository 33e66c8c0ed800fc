"""Parts on processes of this machine: `--workers`, without Dask."""

import os
import signal
import subprocess
import time
from collections import deque
from pathlib import Path

import pytest

from shapefit.config import FitConfig
from shapefit.pipelines.parts.part import Job
from shapefit.pipelines.parts.plan import plan_parts
from shapefit.pipelines.parts.processes import on_processes
from tests.pipelines.parts.test_cluster import (
    LIMIT,
    PARTS,
    SIZE,
    command,
    data,
    fit,
    in_the_middle,
    listed,
    results,
    same_bits,
)

__all__ = ["data"]


def children(pid: int) -> list[int]:
    """Processes that a process started."""
    text = Path(f"/proc/{pid}/task/{pid}/children").read_text()
    return [int(word) for word in text.split()]


def listening(pids: list[int]) -> bool:
    """Whether one of these processes listens on a port of TCP."""
    states = Path("/proc/net/tcp").read_text().splitlines()[1:]
    open_ones = {f"socket:[{line.split()[9]}]" for line in states if line.split()[3] == "0A"}
    links = [os.readlink(each) for pid in pids for each in Path(f"/proc/{pid}/fd").iterdir()]
    return bool(open_ones & set(links))


def test_parts_are_the_bits_of_one_run_and_nothing_is_left(data, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    done = fit(data, "two/", "--workers", 2)
    assert done.returncode == 0, done.stderr
    same_bits(data, "two/")
    assert f"{PARTS} of {PARTS} parts done" in done.stderr.splitlines()[-1]
    assert "Dask" not in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_killed_process_is_replaced_and_no_port_is_open(data):
    with in_the_middle(data, "worker/", "--workers", 2) as process:
        own = children(process.pid)
        assert not listening([process.pid, *own])
        os.kill(own[-1], signal.SIGKILL)
        _, told = process.communicate(timeout=LIMIT)
        assert process.returncode == 0, told
    same_bits(data, "worker/")


@pytest.mark.parametrize("by", [signal.SIGKILL, signal.SIGINT])
def test_a_run_that_was_ended_goes_on(data, by):
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


def test_a_part_that_kills_its_process_is_named(data, monkeypatch, tmp_path):
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
    config = FitConfig(
        landmarks=["views.h5"], dictionary="dict.h5", output="deadly/", partition=SIZE
    )
    Path("deadly").mkdir()
    parts = plan_parts(config)[:3]
    jobs = deque(Job(part, config, Path("deadly").absolute()) for part in parts)
    found = {done.part.file: done.error for done in on_processes(jobs, 2)}
    assert found[parts[0].file] is found[parts[2].file] is None
    assert "3 processes died of it" in found[parts[1].file]
    assert subprocess.run(command("deadly/", "--dry-run"), cwd=data, check=True).returncode == 0
