"""Options that all commands share, hints, completion, progress without a terminal."""

from __future__ import annotations

import os
import subprocess
import sys
from itertools import count

import pytest

from shapefit.pipelines.outcome import Failure, Outcome


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (["--lambda", "0.2"], "--lambda; it is a key of the config: --set lambda=0.2"),
        (["--lambda=0.2"], "--lambda; it is a key of the config: --set lambda=0.2"),
        (["--lambda"], "--lambda; it is a key of the config: --set lambda=VALUE"),
        (["--leave-out", "item"], "--leave-out; it is a key of the config: --set leave_out=item"),
        (["--threshold", "3"], "it is a key of the config: --set outliers.threshold=3"),
        (["--outliers.method=l1"], "it is a key of the config: --set outliers.method=l1"),
        (["--softness", "1"], "--set camera.softness=1"),
    ],
)
def test_an_option_that_is_a_key_names_the_setting(shapefit, arguments, hint):
    told = shapefit("fit", "-c", "fit.yaml", *arguments)
    assert told.code == 2
    assert hint in told.err


def test_an_option_that_is_nothing_is_told_as_before(shapefit):
    told = shapefit("fit", "--lamda", "2")
    assert told.code == 2
    assert "--set" not in told.err
    assert "No such option" in told.err


def test_quiet_prints_failures_and_nothing_else(shapefit, fake_pipeline):
    outcome = Outcome(done=2, failures=(Failure("a", "b"),), warnings=("odd",))
    fake_pipeline("fit.run", [outcome])
    told = shapefit("fit", "-c", "fit.yaml", "-q")
    assert (told.code, told.out, told.err) == (1, "", "Failed: a: b\n")


def test_quiet_keeps_what_a_command_prints(shapefit, fake_pipeline):
    fake_pipeline("evaluate.run", [Outcome(done=1, note="| table |")])
    told = shapefit("eval", "result.h5", "--truth", "shapes.h5", "-o", "report", "--quiet")
    assert (told.out, told.err) == ("| table |\n", "")


def test_verbose_names_the_config_and_every_failure(shapefit, fake_pipeline):
    failures = tuple(Failure(f"img_{i}", "hidden") for i in range(30))
    fake_pipeline("fit.run", [Outcome(done=30, failures=failures)])
    told = shapefit("fit", "-c", "fit.yaml", "-v")
    assert told.err.startswith("Config: fit.yaml\n")
    assert told.err.count("Failed: ") == 30


def test_quiet_and_verbose_exclude_each_other(shapefit):
    told = shapefit("fit", "-c", "fit.yaml", "-q", "-v")
    assert told.code == 2
    assert "-q and -v exclude each other" in told.err


def test_progress_is_a_line_now_and_then_without_a_terminal(shapefit, fake_pipeline, monkeypatch):
    clock = count(0, 4)  # seconds: a line after every third look at the clock
    monkeypatch.setattr("shapefit.cli.report.time.monotonic", lambda: next(clock))
    fake_pipeline("fit.run", [Outcome(done=10, total=90, note="gap 1e-5")] * 9)
    told = shapefit("fit", "-c", "fit.yaml")
    lines = [line for line in told.err.splitlines() if " of 90 images, " in line]
    assert 2 <= len(lines) <= 4
    assert lines[0].startswith("fit: ")
    assert lines[0].endswith(" s; gap 1e-5")


def test_a_short_run_has_no_such_line(shapefit, fake_pipeline):
    fake_pipeline("fit.run", [Outcome(done=10, total=90)] * 9)
    assert " of 90 " not in shapefit("fit", "-c", "fit.yaml").err


def complete(words: str) -> list[str]:
    """Return what bash is offered for the last of the words."""
    environment = {
        **os.environ,
        "_SHAPEFIT_COMPLETE": "bash_complete",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split()) - 1),
    }
    line = [sys.executable, "-m", "shapefit"]
    done = subprocess.run(line, env=environment, capture_output=True, text=True, check=True)
    return [answer.split(",", 1)[1] for answer in done.stdout.splitlines()]


def test_the_shell_completes_commands_configs_and_keys():
    assert complete("shapefit learn") == ["learn-dict"]
    assert complete("shapefit fit -c car") == ["cars"]
    assert complete("shapefit fit --set outliers.thr") == ["outliers.threshold="]


def test_the_shell_gets_its_script():
    environment = {**os.environ, "_SHAPEFIT_COMPLETE": "zsh_source"}
    line = [sys.executable, "-m", "shapefit"]
    done = subprocess.run(line, env=environment, capture_output=True, text=True, check=True)
    assert "#compdef shapefit" in done.stdout


def test_the_package_is_the_command():
    line = [sys.executable, "-m", "shapefit", "--version"]
    done = subprocess.run(line, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("shapefit, version ")
