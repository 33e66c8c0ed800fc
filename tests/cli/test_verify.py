"""What `shapefit verify` and `shapefit view` hand on, print, open and exit with."""

import webbrowser
from pathlib import Path

import pytest

from shapefit.config import ViewConfig
from shapefit.pipelines import verify
from shapefit.pipelines.outcome import Failure, Outcome


@pytest.fixture
def requests(monkeypatch):
    """Put a pipeline in place that yields `outcomes`; returns what it is asked."""
    asked = []

    def install(*outcomes):
        def run(request):
            asked.append(request)
            for outcome in outcomes:
                if isinstance(outcome, Exception):
                    raise outcome
                yield outcome

        monkeypatch.setattr(verify, "run", run)
        return asked

    return install


def test_the_table_goes_to_stdout(shapefit, requests):
    asked = requests(Outcome(done=3, total=3), Outcome(note="| claim |"))
    result = shapefit("verify", "result.h5", "-d", "dict.h5", "--landmarks", "views.h5")
    assert asked == [verify.Request(Path("result.h5"), Path("dict.h5"), (Path("views.h5"),))]
    assert (result.code, result.out) == (0, "| claim |\n")
    assert result.err.startswith("verify: 3 images in ")


def test_a_claim_that_does_not_hold_is_a_failure(shapefit, requests):
    requests(Outcome(done=3, failures=(Failure("a", "the objective is P: off by 1"),)))
    result = shapefit("verify", "result.h5", "-d", "dict.h5")
    assert result.code == 1
    assert "Failed: a: the objective is P: off by 1\n" in result.err


@pytest.fixture
def pages(fake_pipeline, folder):
    return fake_pipeline("view.run", [Outcome(done=3, written=(folder / "page.html",))])


def test_arguments_reach_the_pipeline(shapefit, pages, folder):
    told = shapefit(
        "view", "result.h5", "views.h5", "--truth", "shapes.h5", "-d", "dict.h5", "-o", "page.html",
        "--set", "images=frames/{item}.png",
    )  # fmt: skip
    assert told.code == 0, told.err
    (config,) = pages
    assert isinstance(config, ViewConfig)
    assert config.files == {"result": (folder / "result.h5",), "views": (folder / "views.h5",)}
    assert config.truth == (folder / "shapes.h5",)
    assert (config.dictionary, config.output) == (folder / "dict.h5", folder / "page.html")
    assert config.images == folder / "frames/{item}.png"
    assert told.err.endswith("view: 3 frames in 0.0 s; wrote page.html\n")


def test_a_page_is_opened_where_that_is_wished(shapefit, pages, folder, monkeypatch):
    opened = []
    monkeypatch.setattr(webbrowser, "open", lambda url: not opened.append(url))
    shapefit("view", "result.h5")
    assert opened == []
    shapefit("view", "result.h5", "--open")
    assert opened == [(folder / "page.html").as_uri()]


def test_without_a_browser_the_page_is_named(shapefit, pages, monkeypatch):
    monkeypatch.setattr(webbrowser, "open", lambda url: False)
    told = shapefit("view", "result.h5", "--open")
    assert told.code == 0
    assert "No browser was found; open" in told.err
