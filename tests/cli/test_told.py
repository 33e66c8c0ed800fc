"""What the command line tells of outcomes and errors of the pipelines."""

import json
import os
import re
from itertools import count
from pathlib import Path

import pytest
from shapefit.cli.report import has_columns

from shapefit.errors import InputError, path_text, printable
from shapefit.pipelines.result import (
    CameraNumbers,
    Counted,
    Failure,
    Numbers,
    Result,
)

FIT = "fit -c fit.yaml"


EVAL = "eval result.h5 --truth shapes.h5 -o report"


PIPELINES = {
    "fit": "fit.fit.fit",
    "eval": "evaluate.run.evaluate_results",
    "view": "view.run.write_page",
}


FAILING = tuple(Failure(f"img_{i}", "hidden") for i in range(27))


NOT_OPTIMAL = [
    Result(warnings=(Counted(n, "image", "not optimal"),)) for n in (128, 13, 1)
]


FORGED = "x\x1b[31mRED\nfit: 8 images in 0.0 s; wrote all"


INTERNAL = (
    "Internal error: ZeroDivisionError: division by zero (this is a bug in shapefit;"
    " --traceback or SHAPEFIT_TRACEBACK=1 shows where)\n"
)


READ = r"Read    views\.h5\n"


TOLD = {
    "a sum of all": (
        FIT,
        [Result(done=2, warnings=("odd",)), Result(done=1)],
        0,
        rf"Warning: odd\n{READ}Result  3 images, \S+ s\n",
    ),
    "a warning once": (
        FIT,
        [Result(warnings=("odd",))] * 3,
        0,
        rf"Warning: odd\n{READ}Result.*\n",
    ),
    "numbers of a warning in sum": (
        FIT,
        NOT_OPTIMAL,
        0,
        rf"Warning: 142 images not optimal\n{READ}Result.*\n",
    ),
    "too few that are trusted": (
        f"{FIT} --fail-untrusted 0.2",
        [Result(done=10, reasons=(Counted(3, "image", "wide error bars"),))],
        1,
        r"Warning: 3 of 10 images not trusted: 3 wide error bars \(-v lists them\)\n"
        r"Failed: 30% are not trusted, more than --fail-untrusted"
        rf" allows\n{READ}Result.*\n",
    ),
    "all that are not trusted": (
        f"{FIT} -v",
        [
            Result(done=2, reasons=(Counted(1, "image", "far", (item,)),))
            for item in "ab"
        ],
        0,
        (
            r"Not trusted: a: far\nNot trusted: b: far\nWarning: 2 of 4 images not"
            r" trusted: 2 far\n.*"
        ),
    ),
    "enough that are trusted": (
        f"{FIT} --fail-untrusted 0.3 -q",
        [Result(done=10, reasons=(Counted(3, "image", "wide error bars"),))],
        0,
        "",
    ),
    "the last note": (
        FIT,
        [Result(note="a"), Result(note="b"), Result()],
        0,
        rf"{READ}Result  0 images, b, \S+ s\n",
    ),
    "no item at all": (FIT, [Result(total=0)], 1, rf"{READ}Result  0 images, \S+ s\n"),
    "rows of the pipeline, and one too long": (
        FIT,
        [
            Result(rows=(("Read", "x: 2 images"), ("Method", "posterior " * 12))),
            Result(
                done=2,
                note="a",
                rows=(("Result", "all well"), ("Next", "shapefit view r.h5")),
                written=(Path.cwd() / "r.h5",),
            ),
        ],
        0,
        rf"Read    x: 2 images\nMethod  (posterior ?){{10}}\n        posterior"
        rf" posterior\n"
        rf"Result  all well, \S+ s\nWrote   {Path.cwd()}/r.h5\nNext    shapefit view"
        r" r.h5\n",
    ),
    "a long row, whose names are not divided at their hyphens": (
        FIT,
        [Result(rows=(("Method", "half-precision " * 9),))],
        0,
        rf"{READ}Method  (half-precision ?){{6}}\n {{8}}(half-precision ?){{3}}\n"
        r"Result.*\n",
    ),
    "a name that is longer than a line": (
        FIT,
        [Result(rows=(("Method", f"a {'x' * 150} b"),))],
        0,
        rf"{READ}Method  a\n {{8}}x{{150}}\n {{8}}b\nResult.*\n",
    ),
    "details": (
        f"{FIT} -v",
        [Result(note="a", rows=(("Result", "all well"),))],
        0,
        rf"{READ}Result  all well, \S+ s\nDetails a\n",
    ),
    "the unit of the outcomes": (
        FIT,
        [Result(done=34000, unit="shape")],
        0,
        rf"{READ}Result  34,000 shapes, .*",
    ),
    "files": (
        FIT,
        [Result(written=tuple(Path.cwd() / name for name in "ab"))],
        0,
        rf"{READ}Result.*\nWrote   {Path.cwd()}/: a, b\n",
    ),
    "many files": (
        FIT,
        [Result(written=tuple(Path(f"/r/{n}.csv") for n in range(9)))],
        0,
        rf"{READ}Result.*\nWrote   9 files in /r/\n",
    ),
    "a page among many files": (
        FIT,
        [Result(written=(Path("/r/p.html"), *(Path(f"/r/{n}") for n in range(9))))],
        0,
        rf"{READ}Result.*\nWrote   /r/p.html and 9 more files\n",
    ),
    "all files": (
        f"{FIT} -v",
        [Result(written=tuple(Path(f"/r/{n}") for n in range(9)))],
        0,
        rf"{READ}Result.*\nWrote   /r/: 0, 1, .* 8\n",
    ),
    "failures": (
        FIT,
        [Result(done=30, failures=FAILING[:15]), Result(failures=FAILING[15:])],
        1,
        r"(Failed: img_1?\d: hidden\n){20}Failed: and 7 more\n"
        rf"{READ}Result  30 images, 27 failed, \S+ s\n",
    ),
    "all failures": (
        f"{FIT} -v",
        [Result(failures=FAILING)],
        1,
        rf"(Failed: [^\n]*\n){{27}}{READ}Result.*\n",
    ),
    "many warnings": (
        FIT,
        [Result(warnings=(f"w{n}",)) for n in range(27)],
        0,
        rf"(Warning: w1?\d\n){{20}}Warning: and 7 more\n{READ}Result.*\n",
    ),
    "failures alone": (
        f"{FIT} -q",
        [Result(failures=FAILING[:1], warnings=("odd",), line="a")],
        1,
        r"Failed: img_0: hidden\n",
    ),
    "no forged line": (
        FIT,
        [Result(failures=(Failure(FORGED, "bad"),), warnings=(FORGED,))],
        1,
        rf"Warning: x\\x1b[^\n]*\nFailed: x\\x1b[^\n]*\n{READ}Result[^\n]*\n",
    ),
    "every problem": (
        FIT,
        [InputError(["a.csv:3: no number", "a.csv:5: repeated"])],
        2,
        r"Error: a.csv:3: no number\nError: a.csv:5: repeated\n",
    ),
    "an internal error": (
        FIT,
        [Result(done=1), ZeroDivisionError("division\nby zero")],
        3,
        re.escape(INTERNAL),
    ),
    "where it arose": (
        f"{FIT} --traceback",
        [ZeroDivisionError("division by zero")],
        3,
        "Traceback .*" + re.escape(INTERNAL),
    ),
    "too little memory": (
        FIT,
        [MemoryError("Unable to allocate 6.71 GiB")],
        2,
        (
            r"Error: there is not enough memory: Unable to allocate 6.71 GiB; give"
            r" fewer items .*"
        ),
    ),
    "an interruption": (
        FIT,
        [Result(done=1), KeyboardInterrupt()],
        130,
        r"Interrupted; no file is left half written.\n",
    ),
}


@pytest.mark.parametrize("case", TOLD)
def test_what_is_told_goes_to_standard_error(shapefit, fake_pipeline, case):
    line, outcomes, code, told = TOLD[case]
    fake_pipeline(PIPELINES["fit"], outcomes)
    done = shapefit(*line.split())
    assert done.code == code
    assert done.out == ""
    assert re.fullmatch(told, done.err, re.DOTALL), done.err


@pytest.mark.parametrize("quiet", [(), ("--quiet",)])
def test_a_table_goes_to_standard_output(shapefit, fake_pipeline, quiet):
    report = (Path.cwd() / "report/report.html",)
    outcomes = [Result(note="ours"), Result(note="| table |", written=report)]
    fake_pipeline(PIPELINES["eval"], outcomes)
    done = shapefit(*EVAL.split(), *quiet)
    assert done.code == 0
    assert done.out == "| table |\n"
    assert done.err == ("" if quiet else "Wrote   report/report.html\n")


def test_progress_is_a_line_now_and_then_without_a_terminal(
    shapefit, fake_pipeline, monkeypatch
):
    """After every third look at the clock."""
    clock = count(0, 25)
    outcomes = [Result(done=10, total=90, note="gap 1e-5")] * 9
    monkeypatch.setattr("shapefit.cli.report.time.monotonic", lambda: next(clock))
    fake_pipeline(PIPELINES["fit"], outcomes)
    told = shapefit(*FIT.split()).err
    lines = [line for line in told.splitlines() if "/90 images, " in line]
    assert 2 <= len(lines) <= 4
    assert lines[0].startswith("fit: ")


SHOWN = {
    "plain text, mañana": "plain text, mañana",
    "x\x1b[31mRED\nfit: wrote all": "x\\x1b[31mRED\\nfit: wrote all",
    "caf\udce9": "caf\\xe9",
    "half \ud800": "half \\ud800",
    "right\u202eleft": "right\\u202eleft",
}


@pytest.mark.parametrize("text", SHOWN)
def test_what_a_terminal_would_obey_is_shown_as_an_escape(text):
    assert printable(text) == SHOWN[text]


def test_paths_are_shown_as_text():
    not_utf8 = os.fsdecode(b"a/caf\xe9")
    assert path_text(not_utf8) == "a/caf\\xe9"
    assert path_text("a/café") == "a/café"


CAMERA = CameraNumbers(perspective=True, focal=1100.0)


@pytest.fixture
def told(shapefit, fake_pipeline):
    """What a fit of three images, of which one failed, tells as JSON."""
    numbers = Numbers(trusted=2, largest_gap=1e-7, camera=CAMERA)
    failed = (Failure("a", "hidden"),)
    outcomes = [Result(done=3, failures=failed), Result(numbers=numbers)]
    fake_pipeline(PIPELINES["fit"], outcomes)
    return json.loads(shapefit(*FIT.split(), "--json").out)


def test_the_numbers_of_a_command(told):
    numbers = told["numbers"]
    assert numbers["images"] == 3
    assert numbers["failed"] == 1
    assert numbers["trusted"] == 2
    assert numbers["largest_gap"] == 1e-7
    assert numbers["camera"] == {
        "perspective": True,
        "focal": 1100.0,
        "principal_point": None,
    }


def keys_of_table(text):
    """Return the keys in the first column of a table."""
    rows = [line.split("|")[1] for line in text.splitlines() if line[:3] == "| `"]
    return set(re.findall(r"`([a-z_]+)`", " ".join(rows)))


def test_the_numbers_of_a_command_are_those_of_the_page(told):
    page = (Path(__file__).parents[2] / "docs/shell.md").read_text()
    _, of_all, of_numbers, *_ = page.split("| key | value |")
    assert keys_of_table(of_all) == set(told)
    assert keys_of_table(of_numbers) == set(told["numbers"])


def test_a_command_without_numbers_has_the_same_keys(shapefit, fake_pipeline):
    fake_pipeline(PIPELINES["view"], [Result(done=3)])
    numbers = json.loads(shapefit("view", "result.h5", "--json").out)["numbers"]
    assert set(numbers) == {*Numbers._fields, "failed"}
    assert numbers["images"] is None
    assert numbers["failed"] == 0
    assert numbers["trusted"] is None


@pytest.mark.parametrize(("columns", "is_bar"), [(80, True), (0, False)])
def test_a_bar_needs_columns(monkeypatch, columns, is_bar):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setattr("sys.stderr.fileno", lambda: 2)
    size = os.terminal_size((columns, 24))
    monkeypatch.setattr("os.get_terminal_size", lambda _stream: size)
    assert has_columns() == is_bar
