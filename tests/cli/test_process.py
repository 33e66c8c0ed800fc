"""The installed command as a process: pipes, signals, terminals, streams, full
disks.
"""

import os
import pty
import resource
import shutil
import signal
import subprocess
import sys
import termios
import textwrap
import time
from pathlib import Path

import h5py
import pytest
from numpy.testing import assert_array_equal

COMMAND = Path(sys.executable).with_name("shapefit")

DRIVER = """
import sys, time
from types import ModuleType
from shapefit.pipelines.result import Result
from shapefit.cli import main

def fit(config):
{body}

module = ModuleType("shapefit.pipelines.fit.fit")
module.fit = fit
sys.modules[module.__name__] = module
main.main()
"""


def driver(folder: Path, body: str) -> list[str]:
    """Return a command line that is `shapefit fit` with the given body of its
    pipeline.
    """
    script = folder / "driver.py"
    script.write_text(
        DRIVER.format(body=textwrap.indent(textwrap.dedent(body), "    "))
    )
    return [sys.executable, str(script), "fit", "-c", "fit.yaml"]


@pytest.mark.parametrize(
    "lines", [1, 100_000], ids=["at the last flush", "while writing"]
)
def test_a_reader_that_stops_reading_is_not_an_internal_error(folder, lines):
    body = f"""
    sys.stdin.readline()
    for number in range({lines}):
        print(number)
    yield Result(done=1)
    """
    buffered = {
        name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"
    }
    process = subprocess.Popen(
        driver(folder, body),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=buffered,
    )
    process.stdout.close()
    process.stdin.write(b"go\n")
    process.stdin.close()
    told = process.stderr.read()
    process.stderr.close()
    assert b"rror" not in told
    assert process.wait() == 128 + signal.SIGPIPE


@pytest.mark.parametrize(
    ("number", "told"),
    [
        (signal.SIGINT, "Interrupted"),
        (signal.SIGTERM, "Ended by SIGTERM"),
        (signal.SIGHUP, "Ended by SIGHUP"),
    ],
)
def test_a_signal_unwinds_the_pipeline(folder, number, told):
    body = """
    try:
        print("ready", flush=True)
        time.sleep(60)
        yield Result(done=1)
    finally:
        print("unwound", flush=True)
    """
    process = subprocess.Popen(
        driver(folder, body),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # where the tests run in the background, SIGINT is ignored, and by their
        # children too
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),
    )
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    assert process.stdout.read() == "unwound\n"
    process.stdout.close()
    assert process.stderr.read() == f"{told}; no file is left half written.\n"
    process.stderr.close()
    assert process.wait() == 128 + number


LOSES = {
    "a callback of a weak reference": """
        import weakref
        class Thing: pass
        thing = Thing()
        def late(_reference):
            print("ready", flush=True)
            time.sleep(1)
        reference = weakref.ref(thing, late)
        del thing
        time.sleep(60)
        yield Result(done=1)
    """,
    "a library that makes it a fault of a file": """
        for number in range(2):
            try:
                try:
                    print("ready", flush=True)
                    time.sleep(60)
                except BaseException as error:
                    raise OSError("the file is damaged") from None
            except OSError:
                yield Result(done=1)
    """,
    "a library that makes it an error of its own": """
        try:
            print("ready", flush=True)
            time.sleep(60)
        except BaseException:
            raise RuntimeError("unspecified error in the library")
        yield Result(done=1)
    """,
    "a destructor": """
        class Thing:
            def __del__(self):
                print("ready", flush=True)
                time.sleep(1)
        thing = Thing()
        del thing
        time.sleep(60)
        yield Result(done=1)
    """,
    "slow cleaning up": """
        try:
            print("ready", flush=True)
            time.sleep(60)
        finally:
            time.sleep(0.5)
            print("unwound", flush=True)
        yield Result(done=1)
    """,
}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("body", LOSES.values(), ids=LOSES)
def test_no_signal_is_lost(folder, body, number):
    process = subprocess.Popen(
        driver(folder, body),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),
    )
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    written, told = process.communicate(timeout=20)
    assert process.returncode == 128 + number
    word = "Interrupted" if number == signal.SIGINT else "Ended by SIGTERM"
    assert told.splitlines()[-1] == f"{word}; no file is left half written."
    assert "rror" not in told
    assert "ignored" not in told
    assert ("unwound" in written) == ("unwound" in body)


def test_a_signal_that_comes_twice_ends_a_command_once(folder):
    process = subprocess.Popen(
        driver(folder, LOSES["slow cleaning up"]),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGINT)
    time.sleep(0.2)
    process.send_signal(signal.SIGTERM)
    written, told = process.communicate(timeout=20)
    assert process.returncode == 128 + signal.SIGINT
    assert told == "Interrupted; no file is left half written.\n"
    assert written == "unwound\n"


BAR_BODY = """
for done in range(3):
    time.sleep(0.15)
    yield Result(done=1, total=3, note=f"gap {done}")
"""


def test_a_terminal_gets_a_bar(folder):
    reader, writer = pty.openpty()
    termios.tcsetwinsize(writer, (24, 80))
    process = subprocess.Popen(
        driver(folder, BAR_BODY), stderr=writer, stdout=subprocess.DEVNULL
    )
    os.close(writer)
    text = b""
    while True:
        try:
            piece = os.read(reader, 4096)
        except OSError:  # the terminal is gone with the process
            break
        if not piece:
            break
        text += piece
    os.close(reader)
    assert process.wait() == 0
    assert b"3/3" in text
    assert b"gap 2" in text


SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"
FULL = pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")

FIT = "fit one_person.csv -d dictionary.h5 -o"
EVAL = "eval result.h5 --truth people_test.h5 -o report --set plots=none"


@pytest.fixture(scope="module")
def fitted(world, tmp_path_factory):
    """A folder with landmarks, a dictionary, a result and its truth."""
    folder = tmp_path_factory.mktemp("streams")
    for name in ("people_test.h5", "one_person.csv"):
        shutil.copy(SAMPLES / name, folder)
    shutil.copy(world.dictionary("people"), folder / "dictionary.h5")
    shutil.copy(world.fit("people", images=world.views("people")), folder / "result.h5")
    return folder


def shell(command: str, folder: Path, unbuffered: str = "") -> tuple[int, str, str]:
    """Return the exit code of a command of shapefit, its output, and what it told."""
    line = f"'{COMMAND}' {command}"
    done = subprocess.run(
        ["sh", "-c", line],
        cwd=folder,
        env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


@FULL
@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize(
    "command", ["fit --help", f"{FIT} r.csv --print-config", EVAL, f"{FIT} -"]
)
def test_a_full_disk_behind_standard_output_is_no_internal_error(
    fitted, command, unbuffered
):
    code, out, told = shell(f"{command} >/dev/full", fitted, unbuffered)
    assert code == 2
    assert out == ""
    assert "Error: standard output: " in told
    assert "free some" in told


UNCOMPILED = """
import sys
installed = [f for f in sys.meta_path if "Redirecting" not in type(f).__name__]
sys.meta_path = installed
sys.path.insert(0, "")
import shapefit
shapefit.fit
"""
"""Python in a clone, into whose environment `pip install .` has put the package."""


def test_sources_that_hide_the_installed_package_say_what_to_do(project: Path):
    done = subprocess.run(
        [sys.executable, "-c", UNCOMPILED],
        cwd=project,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "No module named" not in done.stderr
    assert f"InputError: {project / 'shapefit'}: " in done.stderr
    assert "pip install -e '.[plots]'" in done.stderr
    assert "another folder" in done.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are Linux's")
@pytest.mark.parametrize("megabytes", [450, 700])
def test_a_fit_goes_on_with_the_threads_that_memory_allows(tmp_path, rng, megabytes):
    for name, shape in (("shapes", (40, 8, 3)), ("views", (2048, 8, 2))):
        rows = [
            ",".join((f"i{item}", f"l{landmark}", *map(repr, point)))
            for item, points in enumerate(rng.normal(size=shape).tolist())
            for landmark, point in enumerate(points)
        ]
        header = "item,landmark,x,y,z" if name == "shapes" else "item,landmark,x,y"
        (tmp_path / f"{name}.csv").write_text("\n".join([header, *rows]))
    limit = megabytes * 2**20
    options = ["views.csv", "-d", "d.h5", "--method", "convex", "-q"]
    learn = ["learn-dict", "shapes.csv", "-o", "d.h5", "--method", "exemplars", "-q"]
    subprocess.run([COMMAND, *learn], cwd=tmp_path, check=True)
    for threads in (1, 64):
        subprocess.run(
            [
                COMMAND,
                "fit",
                *options,
                "-o",
                f"{threads}.h5",
                f"--set=threads={threads}",
            ],
            cwd=tmp_path,
            check=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)),
        )
    with h5py.File(tmp_path / "1.h5") as one, h5py.File(tmp_path / "64.h5") as many:
        assert_array_equal(one["shapes"][:], many["shapes"][:])
