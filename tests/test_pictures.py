"""The pictures of README, docs and gallery: all are made, and none is older than what
draws it.
"""

import json
import re
import shutil
from pathlib import Path

import pytest

from tools import page_pictures
from tools.page_pictures import DRAWN_BY, IMAGES, PICTURES, digest_of_code

SHOWN = re.compile(r"\]\((?:\.\./|docs/)?images/([\w/.]+)\)")


def test_every_picture_that_is_shown_is_made_and_every_one_made_is_shown(project):
    shown = set()
    for page in [project / "README.md", *(project / "docs").rglob("*.md")]:
        shown |= set(SHOWN.findall(page.read_text(encoding="utf-8")))
    there = {
        path.relative_to(IMAGES).as_posix()
        for path in IMAGES.rglob("*.*")
        if path != DRAWN_BY
    }
    assert shown == there == set(PICTURES)


def test_no_picture_is_older_than_the_code_that_draws_it():
    stale = page_pictures.stale_pictures()
    names = " ".join(stale)
    assert not stale, f"make them anew: make pictures, or the tool alone with {names}"


def test_a_picture_is_older_once_what_draws_it_has_changed(project, tmp_path):
    for name, picture in PICTURES.items():
        before = digest_of_code(name)
        assert json.loads(DRAWN_BY.read_text(encoding="utf-8")).keys() == {*PICTURES}
        for glob in picture.sources:
            paths = sorted(project.glob(glob))
            assert paths, glob
            copy = tmp_path / name
            for source in picture.sources:
                for path in project.glob(source):
                    target = copy / path.relative_to(project)
                    target.parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(path, target)
            assert digest_of_code(name, copy) == before
            changed = copy / paths[0].relative_to(project)
            changed.write_text(changed.read_text("utf-8") + "\n\n , \n", "utf-8")
            assert digest_of_code(name, copy) == before
            changed.write_text(changed.read_text("utf-8") + "x = 1\n", "utf-8")
            assert digest_of_code(name, copy) != before


@pytest.mark.parametrize("readme", ["README.md"])
def test_the_animation_shows_what_the_first_command_makes(project, readme):
    """The command of README and that of the demo, whose result is animated."""
    text = (project / readme).read_text(encoding="utf-8")
    (command,) = re.findall(r"shapefit (fit sample_data/openpose.*) -o walk", text)
    makefile = (project / "Makefile").read_text(encoding="utf-8")
    demo = makefile.replace("\\\n", "")
    (made,) = re.findall(r"\(SHAPEFIT\) (fit sample_data/openpose.*?) -o \S+walk", demo)
    focal = re.compile(r"--(?:focal|frame-rate|image-size) \S+")
    assert focal.findall(command) == focal.findall(made)
    assert len(focal.findall(command)) == 3


def test_only_what_is_asked_for_is_made(monkeypatch, tmp_path):
    drawn = []
    stored = tmp_path / "drawn_by.json"
    stored.write_text('{"a": "old", "b": "old"}')
    monkeypatch.setattr(page_pictures, "DRAWN_BY", stored)

    def draw(target: Path) -> None:
        drawn.append(target.name)

    def lacks(target: Path) -> None:
        raise page_pictures.MissingInput("make demo makes it")

    pictures = {
        "a": page_pictures.Picture(draw, ()),
        "b": page_pictures.Picture(lacks, ()),
    }
    monkeypatch.setattr(page_pictures, "PICTURES", pictures)
    page_pictures.make_pictures(["b"])
    assert json.loads(stored.read_text()) == {"a": "old", "b": "old"}
    page_pictures.make_pictures(["a"])
    assert drawn == ["a"]
    assert json.loads(stored.read_text())["a"] != "old"
