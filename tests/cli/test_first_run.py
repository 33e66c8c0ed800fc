"""The first run of an installation: nothing is compiled, cached or loaded on the solver's clock."""

import json
import os
import subprocess
import sys

import pytest

WRITES = """
import json, os, resource, sys
written = set()
def hook(event, arguments):
    name = arguments[0] if arguments else None
    if event == "open" and isinstance(name, (str, bytes, os.PathLike)):
        if (arguments[2] or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT):
            written.add(os.path.realpath(os.fsdecode(name)))
    elif event in ("os.mkdir", "os.rename"):
        written.add(os.path.realpath(os.fsdecode(name)))
sys.addaudithook(hook)
sys.dont_write_bytecode = True
from shapefit.cli.main import run
code = run(sys.argv[1:])
print(json.dumps({"code": code, "written": sorted(written),
    "seconds": resource.getrusage(resource.RUSAGE_SELF).ru_utime}))
"""

CLOCK = """
import json, os, sys, time
from types import SimpleNamespace
import shapefit.pipelines.fit.run as fitting
from shapefit.cli.main import run

def clock():
    loaded.append(set(sys.modules))
    return time.perf_counter()

fitting.time = SimpleNamespace(perf_counter=clock)
settings = json.loads(sys.argv[1])
for number, options in enumerate(settings):
    sys.stdout.flush()
    if os.fork() == 0:  # each is the first run of its process
        loaded = []
        code = run([*sys.argv[2:], "-o", f"{number}.h5", *options])
        new = [sorted(after - before) for before, after in zip(loaded[::2], loaded[1::2])]
        print(json.dumps({"code": code, "times": len(new), "new": sum(new, [])}), flush=True)
        os._exit(0)
    os.wait()
"""

PERSPECTIVE = "camera={focal: files}"
CARS = [
    *(["outliers=" + kind] for kind in ("none", "l1", "sparse-error")),
    *(["method=" + method] for method in ("convex+refine", "alternate")),
    ["method=mean-shape", PERSPECTIVE],
    ["outliers=ransac", PERSPECTIVE],
    ["leave_one_out=true_model"],
    ["method=convex+refine", "signed=true"],
]


@pytest.fixture(scope="module")
def cars(project, tmp_path_factory):
    """A dictionary of the sample cars."""
    path = tmp_path_factory.mktemp("cars") / "cars.h5"
    shapes = project / "sample_data/cars.h5"
    learn = ("learn-dict", shapes, "-o", path, "--set=method=exemplars", "--set=align=none")
    assert script(WRITES, *learn)["code"] == 0
    return path


def script(text: str, *arguments: object, **environment: str) -> dict:
    """Run a script in a process of its own; return what it prints last."""
    done = subprocess.run(
        [sys.executable, "-c", text, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
        env=os.environ | environment,
    )
    return json.loads(done.stdout.splitlines()[-1])


def test_a_fit_without_a_home_compiles_nothing_and_leaves_no_cache(project, cars, tmp_path):
    home = {"HOME": "/nonexistent", "XDG_CACHE_HOME": "/nonexistent", "TMPDIR": "/nonexistent"}
    views, out = project / "sample_data/cars_views.h5", tmp_path / "out"
    out.mkdir()
    done = script(WRITES, "fit", views, "-d", cars, "-o", out / "result.h5", **home)
    assert done["code"] == 0
    elsewhere = [name for name in done["written"] if not name.startswith(str(out))]
    assert [name for name in elsewhere if not name.startswith(("/dev/", "/proc/"))] == []
    assert done["seconds"] < 10  # of the processor: about 0.5, where compiling took 30


def test_nothing_is_loaded_while_the_clock_of_solving_runs(project, cars, tmp_path):
    options = [[word for each in one for word in ("--set", each)] for one in CARS]
    views = project / "sample_data/cars_views.h5"
    done = subprocess.run(
        [sys.executable, "-c", CLOCK, json.dumps(options), "fit", str(views), "-d", str(cars)],
        capture_output=True, text=True, check=True, timeout=120, cwd=tmp_path,
    )  # fmt: skip
    found = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(found) == len(CARS)
    for settings, one in zip(CARS, found, strict=True):
        assert one["code"] in (0, 1), settings
        assert one["times"] > 0, settings
        assert one["new"] == [], settings
