"""What the commands hand to their pipelines and print; options, hints, completion, progress."""

import os
import subprocess
import sys
from itertools import count
from pathlib import Path

import pytest

from shapefit.config import (
    EvalConfig,
    FitConfig,
    LearnDictConfig,
    ProjectConfig,
    load_config,
)
from shapefit.pipelines.outcome import Failure, Outcome


@pytest.mark.parametrize(
    ("arguments", "pipeline", "kind"),
    [
        (["learn-dict", "shapes.h5", "-o", "d.h5"], "learn_dict.run", LearnDictConfig),
        (["fit", "views.h5", "-d", "dict.h5", "-o", "-"], "fit.run", FitConfig),
        (["fit", "views.h5", "-d", "dict.h5", "-o", "parts/"], "parts.run", FitConfig),
        (["fit", "views.h5", "-d", "dict.h5", "-o", "manifest.jsonl"], "fit.run", FitConfig),
        (["project", "shapes.h5", "-o", "v.h5"], "projection", ProjectConfig),
        (["eval", "result.h5", "--truth", "shapes.h5", "-o", "r"], "evaluate.run", EvalConfig),
    ],
)
def test_each_command_calls_its_pipeline(shapefit, fake_pipeline, arguments, pipeline, kind):
    configs = fake_pipeline(pipeline, [Outcome(done=1)])
    assert shapefit(*arguments).code == 0
    assert [type(config) for config in configs] == [kind]


def test_arguments_and_options_reach_the_pipeline(shapefit, fake_pipeline, folder):
    (folder / "more.csv").touch()
    configs = fake_pipeline("fit.run", [Outcome()])
    shapefit(
        "fit", "-c", "fit.yaml", "v*.h5", "more.csv", "-d", "dict.h5", "-o", "out.csv",
        "--set", "lambda=1e-3", "--set", "outliers.method=l1",
    )  # fmt: skip
    (config,) = configs
    assert config.landmarks == (folder / "views.h5", folder / "more.csv")
    assert config.output == folder / "out.csv"
    assert (config.lam, config.outliers.method) == (1e-3, "l1")


def test_truth_can_be_given_twice(shapefit, fake_pipeline, folder):
    configs = fake_pipeline("evaluate.run", [Outcome(note="table")])
    shapefit("eval", "result.h5", "--truth", "shapes.h5", "--truth", "views.h5", "-o", "report")
    assert configs[0].truth == (folder / "shapes.h5", folder / "views.h5")


def test_text_goes_to_stderr_only(shapefit, fake_pipeline, folder):
    fake_pipeline(
        "fit.run",
        [
            Outcome(done=2, total=3, note="gap 1e-5", warnings=("y_axis is down",)),
            Outcome(done=1, total=3, written=(folder / "result.h5",)),
        ],
    )
    result = shapefit("fit", "-c", "fit.yaml")
    assert result.out == ""
    assert "Warning: y_axis is down\n" in result.err
    assert "fit: 3 images in " in result.err
    assert result.err.endswith("wrote result.h5\n")


def test_eval_prints_its_table_to_stdout(shapefit, fake_pipeline):
    table = "| method | error |\n|---|---|\n| ours | 0.3 |"
    fake_pipeline("evaluate.run", [Outcome(done=1, note="ours"), Outcome(note=table)])
    result = shapefit("eval", "result.h5", "--truth", "shapes.h5", "-o", "report")
    assert result.out == table + "\n"
    assert "| method" not in result.err


def test_failed_items_give_exit_code_1_and_are_listed(shapefit, fake_pipeline):
    failures = tuple(Failure(f"img_{i}", "all landmarks hidden") for i in range(23))
    fake_pipeline(
        "fit.run", [Outcome(done=30, failures=failures[:15]), Outcome(failures=failures[15:])]
    )
    result = shapefit("fit", "-c", "fit.yaml")
    assert result.code == 1
    assert "Failed: img_0: all landmarks hidden\n" in result.err
    assert "Failed: img_19: all landmarks hidden\n" in result.err
    assert "img_20" not in result.err
    assert "Failed: and 3 more\n" in result.err
    assert "23 failed" in result.err


def test_print_config_prints_yaml_and_does_nothing(shapefit, fake_pipeline, folder):
    configs = fake_pipeline("fit.run", [])
    result = shapefit("fit", "-c", "fit.yaml", "--set", "lambda=2", "--print-config")
    assert (result.code, result.err, configs) == (0, "", [])
    (folder / "printed.yaml").write_text(result.out)
    expected = load_config("fit", Path("fit.yaml"), ["lambda=2"])
    assert load_config("fit", Path("printed.yaml")) == expected


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


def test_progress_is_a_line_now_and_then_without_a_terminal(shapefit, fake_pipeline, monkeypatch):
    clock = count(0, 4)  # seconds: a line after every third look at the clock
    monkeypatch.setattr("shapefit.cli.report.time.monotonic", lambda: next(clock))
    fake_pipeline("fit.run", [Outcome(done=10, total=90, note="gap 1e-5")] * 9)
    told = shapefit("fit", "-c", "fit.yaml")
    lines = [line for line in told.err.splitlines() if " of 90 images, " in line]
    assert 2 <= len(lines) <= 4
    assert lines[0].startswith("fit: ")
    assert lines[0].endswith(" s; gap 1e-5")


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
