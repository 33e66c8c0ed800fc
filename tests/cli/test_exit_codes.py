"""What becomes of every kind of error."""

import sys

import pytest

from shapefit.errors import InputError
from shapefit.pipelines.outcome import Outcome


def test_an_input_error_names_every_problem(shapefit, fake_pipeline):
    fake_pipeline("fit.run", [InputError(["a.csv:3: no number", "a.csv:5: repeated"])])
    result = shapefit("fit", "-c", "fit.yaml")
    assert result.code == 2
    assert result.err == "Error: a.csv:3: no number\nError: a.csv:5: repeated\n"


def test_an_internal_error_is_one_line(shapefit, fake_pipeline):
    fake_pipeline("fit.run", [Outcome(done=1), ZeroDivisionError("division\nby zero")])
    result = shapefit("fit", "-c", "fit.yaml")
    assert result.code == 3
    assert result.err == (
        "Internal error: ZeroDivisionError: division by zero "
        "(this is a bug in shapefit; --traceback or SHAPEFIT_TRACEBACK=1 shows where)\n"
    )


def test_a_lack_of_memory_is_no_internal_error(shapefit, fake_pipeline):
    fake_pipeline("fit.run", [MemoryError("Unable to allocate 6.71 GiB for an array")])
    result = shapefit("fit", "-c", "fit.yaml")
    assert result.code == 2
    assert result.err == (
        "Error: memory: there is not enough: Unable to allocate 6.71 GiB for an array; give fewer "
        "items at a time, or raise the limit of memory (ulimit -v)\n"
    )


def test_the_traceback_can_be_seen(shapefit, fake_pipeline, monkeypatch):
    fake_pipeline("fit.run", [ZeroDivisionError("division by zero")])
    assert "Traceback" in shapefit("fit", "-c", "fit.yaml", "--traceback").err
    monkeypatch.setenv("SHAPEFIT_TRACEBACK", "0")
    assert "Traceback" not in shapefit("fit", "-c", "fit.yaml").err
    monkeypatch.setenv("SHAPEFIT_TRACEBACK", "1")
    result = shapefit("fit", "-c", "fit.yaml")
    assert result.code == 3
    assert "Traceback" in result.err


def test_an_interrupt_is_not_an_error(shapefit, fake_pipeline):
    fake_pipeline("fit.run", [Outcome(done=1), KeyboardInterrupt()])
    result = shapefit("fit", "-c", "fit.yaml")
    assert result.code == 130
    assert result.err == "Interrupted; no file is left half written.\n"


def test_the_pipeline_is_closed_when_the_command_line_breaks_off(
    shapefit, fake_pipeline, monkeypatch
):
    closed = []

    class Outcomes:
        def __iter__(self):
            yield Outcome(done=1)

        def close(self):
            closed.append(True)

    fake_pipeline("fit.run", [])
    monkeypatch.setattr(
        sys.modules["shapefit.pipelines.fit.run"], "run", lambda _config: Outcomes()
    )
    monkeypatch.setattr("shapefit.cli.report.Report.add", lambda *_: 1 / 0)
    assert shapefit("fit", "-c", "fit.yaml").code == 3
    assert closed == [True]


@pytest.mark.parametrize("arguments", [["--help"], ["-h"], ["--version"], ["fit", "--help"]])
def test_help_and_version_go_to_stdout(shapefit, arguments):
    result = shapefit(*arguments)
    assert result.code == 0
    assert "shapefit" in result.out
    assert result.err == ""
