"""Of very many images a page considers some: the same rows of every file, and those to be kept."""

from __future__ import annotations

import numpy as np
import pytest

from shapefit.config import ViewConfig
from shapefit.errors import InputError
from shapefit.io.options import AS_THEY_ARE
from shapefit.pipelines.view import frames as module
from shapefit.pipelines.view.frames import list_files
from shapefit.pipelines.view.run import make_page, run


@pytest.fixture
def parts(desk, monkeypatch):
    """Results of 1,000 images in ten parts, of which 100 are listed."""
    monkeypatch.setattr(module, "MOST_LISTED", 100)
    return tuple(
        desk.result(
            f"part-{part}.h5",
            n=100,
            items=tuple(f"i{n}" for n in range(100 * part, 100 * part + 100)),
            frame_rate=60.0,
        )
        for part in range(10)
    )


def listed(config: ViewConfig, *kept: str) -> tuple[module.Listed, list[str]]:
    found = list_files(config, AS_THEY_ARE, kept)
    return found, [item for one in found.listings["fit"] for item in one.items]


def test_every_part_keeps_the_same_rows(parts):
    found, items = listed(ViewConfig(files={"fit": parts}))
    assert (found.count, found.step) == (1000, 16)
    assert items == [f"i{100 * part + row}" for part in range(10) for row in range(0, 100, 16)]


def test_some_are_kept_in_any_case(parts):
    _, items = listed(ViewConfig(files={"fit": parts}), "i7", "i999")
    assert {"i7", "i999", "i0", "i16"} <= set(items)
    assert len(items) == 72


def test_the_chosen_ones_are_counted(parts):
    found, items = listed(ViewConfig(files={"fit": parts}, items=("i1?",)))
    assert (found.count, found.step) == (10, 1)
    assert items == [f"i{n}" for n in range(10, 20)]
    with pytest.raises(InputError, match="no item of"):
        listed(ViewConfig(files={"fit": parts}, items=("none",)))


def test_a_page_of_some_frames_says_so(parts):
    page = make_page(ViewConfig(files={"fit": parts, "two": parts[::-1]}))
    assert "Every 16th of 1,000 frames is shown" in page.scene.notes[0]
    assert page.scene.frame_rate == 60 / 16
    assert len(page.scene.items) == 70
    for layer in page.scene.layers:
        assert np.isfinite(layer.points).all()


def test_files_that_cannot_be_read_are_named_and_the_others_shown(parts, tmp_path):
    for part in parts[1:3]:
        part.write_bytes(part.read_bytes()[:1000])
    (outcome,) = run(ViewConfig(files={"fit": parts}, output=tmp_path / "page.html"))
    assert [failure.item for failure in outcome.failures] == [str(part) for part in parts[1:3]]
    assert outcome.done == 8 * 7  # every 16th
    with pytest.raises(InputError, match="part-1") as found:
        make_page(ViewConfig(files={"fit": parts, "two": parts[1:3]}))
    assert len(found.value.problems) == 2
