"""`view` hands its files on, and opens what it wrote where that is wished."""

from __future__ import annotations

import webbrowser

import pytest

from shapefit.config import ViewConfig
from shapefit.pipelines.outcome import Outcome


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


def test_no_files_are_bad_usage(shapefit):
    told = shapefit("view")
    assert told.code == 2
    assert "missing key 'files'" in told.err
