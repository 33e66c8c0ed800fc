"""What the command line hands to the pipelines."""

import os
import re
import signal
import webbrowser
from pathlib import Path

import pytest
from shapefit.cli import main

from shapefit.config import CONFIGS
from shapefit.config.model import list_config_keys
from shapefit.config.reference import describe_keys
from shapefit.pipelines import verify
from shapefit.pipelines.result import (
    Failure,
    Result,
)

FIT = "fit -c fit.yaml"


PIPELINES = {
    "fit": "fit.fit.fit",
    "eval": "evaluate.run.evaluate_results",
    "view": "view.run.write_page",
}


def test_arguments_and_options_reach_a_fit(shapefit, fake_pipeline, folder):
    configs = fake_pipeline(PIPELINES["fit"], [Result()])
    line = f"{FIT} v*.h5 dict.h5 -o out.csv --set lambda=1e-3 --set outliers=l1"
    shapefit(*line.split(), "-d", "shapes.h5")
    (config,) = configs
    assert config.landmarks == (folder / "views.h5", folder / "dict.h5")
    assert config.output == folder / "out.csv"
    assert config.lam == 1e-3
    assert config.outliers == "l1"


VIEW = (
    "view result.h5 views.h5 --truth shapes.h5 --truth views.h5 -d dict.h5"
    " -o page.html --set images=frames"
)


def test_arguments_and_options_reach_a_view(shapefit, fake_pipeline, folder):
    outcome = Result(done=3, written=(folder / "page.html",))
    configs = fake_pipeline(PIPELINES["view"], [outcome])
    told = shapefit(*VIEW.split()).err
    (config,) = configs
    read = r"Read    result.h5, views.h5\nResult  3 frames, \S+ s\n"
    assert config.files == {
        "result": (folder / "result.h5",),
        "views": (folder / "views.h5",),
    }
    assert config.truth == (folder / "shapes.h5", folder / "views.h5")
    assert config.dictionary == folder / "dict.h5"
    assert config.output == folder / "page.html"
    assert config.images == folder / "frames"
    assert re.fullmatch(rf"{read}Wrote   page.html\n", told)


def test_verify_hands_on_its_arguments(shapefit, monkeypatch):
    requests = []
    failures = (Failure("a", "the objective is P: off by 1"),)

    def verify_results(request):
        requests.append(request)
        yield Result(done=3, failures=failures)
        yield Result(note="| claim |")

    monkeypatch.setattr(verify, "verify_results", verify_results)
    told = shapefit("verify", "result.h5", "-d", "dict.h5", "--landmarks", "views.h5")
    (request,) = requests
    landmarks = (Path("views.h5"),)
    assert request == verify.Request(Path("result.h5"), Path("dict.h5"), landmarks)
    assert told.code == 1
    assert told.out == "| claim |\n"
    assert told.err == "Failed: a: the objective is P: off by 1\n"


@pytest.fixture
def written_page(fake_pipeline, folder):
    """The page that `view` writes."""
    page = folder / "page.html"
    fake_pipeline(PIPELINES["view"], [Result(done=3, written=(page,))])
    return page


@pytest.fixture
def opened(monkeypatch):
    """The addresses that a browser is asked to open."""
    addresses = []

    def open_address(address):
        addresses.append(address)
        return True

    monkeypatch.setattr(webbrowser, "open", open_address)
    return addresses


def test_a_page_is_opened_where_that_is_wished(shapefit, written_page, opened):
    shapefit("view", "result.h5", "--open")
    assert opened == [written_page.as_uri()]


def test_a_page_is_not_opened_by_itself(shapefit, written_page, opened):
    shapefit("view", "result.h5")
    assert opened == []


def test_without_a_browser_the_page_is_named(shapefit, written_page, monkeypatch):
    monkeypatch.setattr(webbrowser, "open", lambda address: False)
    told = shapefit("view", "result.h5", "--open")
    assert "No browser was found; open" in told.err


@pytest.mark.parametrize("command", CONFIGS)
def test_every_key_is_listed(shapefit, command):
    told = shapefit("config", command).out
    names = {line.split(":")[0] for line in told.splitlines() if line[0] != " "}
    assert names == {row.name for row in describe_keys(CONFIGS[command])}


@pytest.mark.parametrize("command", CONFIGS)
def test_every_key_is_printed_without_inputs(shapefit, command):
    told = shapefit(command, "--print-config")
    keys = {line.split(":")[0] for line in told.out.splitlines() if line[0] not in " -"}
    assert told.code == 0
    assert told.err == ""
    assert keys == {path[0] for path in list_config_keys(CONFIGS[command])}


@pytest.fixture
def ask_for_the_version(monkeypatch):
    """Run the program with these variables; handlers of signals stay as they are."""

    def run(variables):
        monkeypatch.setattr("sys.argv", ["shapefit", "--version"])
        monkeypatch.setattr("gc.disable", lambda: None)
        monkeypatch.setattr("signal.getsignal", lambda _number: signal.SIG_IGN)
        monkeypatch.setattr("os.environ", variables)
        with pytest.raises(SystemExit) as ended:
            main.main()
        assert ended.value.code == 0

    return run


@pytest.mark.parametrize(
    ("variables", "used"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")]
)
def test_a_process_has_one_thread_of_blas_where_nobody_says_how_many(
    ask_for_the_version, variables, used
):
    """Those of several processes would wait for one another."""
    ask_for_the_version(dict(variables))
    assert os.environ["OPENBLAS_NUM_THREADS"] == used
