"""A folder of results: its parts are those of the manifest, and each is verified by itself."""

import json
import shutil

import h5py
import pytest

from shapefit.config import FitConfig
from shapefit.errors import InputError
from shapefit.pipelines.partition.run import run as fit


@pytest.fixture(scope="session")
def honest(dictionaries, landmarks, tmp_path_factory):
    """A folder with two parts of one file."""
    folder = tmp_path_factory.mktemp("parts") / "honest"
    config = FitConfig(
        landmarks=[str(landmarks["cars"])],
        dictionary=str(dictionaries["cars"]),
        output=f"{folder}/",
        partition=64,
    )
    list(fit(config))
    return folder


@pytest.fixture
def folder(honest, tmp_path):
    shutil.copytree(honest, tmp_path / "folder")
    return tmp_path / "folder"


def edit(folder, change):
    path = folder / "manifest.jsonl"
    run, *parts = map(json.loads, path.read_text().splitlines())
    lines = [run, *change(parts)]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))


@pytest.mark.parametrize("with_landmarks", [True, False])
def test_an_honest_folder_is_accepted(folder, verify, dictionaries, landmarks, with_landmarks):
    given = [landmarks["cars"]] if with_landmarks else []
    found = verify(folder, dictionaries["cars"], given)
    assert (found.done, found.failures) == (108, {})
    assert "Proved: 108 of 108 images" in found.note


def exchange(folder):
    one, two = folder / "part-00000.h5", folder / "part-00001.h5"
    one.rename(folder / "third")
    two.rename(one)
    (folder / "third").rename(two)


def lose_file(folder):
    (folder / "part-00001.h5").unlink()


def add_file(folder):
    shutil.copy(folder / "part-00001.h5", folder / "part-00002.h5")


def touch_up(folder):
    """Change what no check of a result by itself looks at, and leave its length as it was."""
    with h5py.File(folder / "part-00001.h5", "a") as file:
        file.attrs["solve_seconds"] = 3.0


def no_parts(folder):
    edit(folder, lambda _: [])


LIES = [touch_up, exchange, lose_file, add_file, no_parts]


@pytest.mark.parametrize("lie", LIES, ids=[lie.__name__ for lie in LIES])
def test_a_changed_folder_is_found(folder, verify, dictionaries, lie):
    lie(folder)
    found = verify(folder, dictionaries["cars"])
    assert found.failures
    if lie is lose_file:
        assert "Proved: 64 of 108 images" in found.note
        assert found.done == 64


def damage(part):
    data = bytearray(part.read_bytes())
    data[2000:12000] = bytes(10000)
    part.write_bytes(data)


@pytest.mark.parametrize("number", [0, 1])
def test_a_damaged_part_is_named_and_the_others_are_checked(folder, verify, dictionaries, number):
    damage(folder / f"part-0000{number}.h5")
    found = verify(folder, dictionaries["cars"])
    assert found.done == [44, 64][number]
    assert "cannot be read" in found.failures[str(folder / f"part-0000{number}.h5")]
    assert f"Proved: {found.done} of 108 images" in found.note


def test_a_folder_of_damaged_parts_is_refused(folder, verify, dictionaries):
    for part in folder.glob("part-*"):
        damage(part)
    with pytest.raises(InputError) as found:
        verify(folder, dictionaries["cars"])
    assert [f"part-0000{number}.h5" in str(found.value) for number in (0, 1)] == [True, True]


@pytest.mark.parametrize("text", ["", "[]\n", "{}\n", '{"config": "", "dictionary": ""}\n{}\n'])
def test_what_is_no_manifest_is_refused(folder, verify, dictionaries, text):
    (folder / "manifest.jsonl").write_text(text)
    with pytest.raises(InputError, match="is not a manifest of results"):
        verify(folder, dictionaries["cars"])


def test_a_part_outside_of_the_folder_is_refused(folder, verify, dictionaries):
    shutil.copy(folder / "part-00001.h5", folder.parent / "r.h5")
    edit(folder, lambda parts: [parts[0], parts[1] | {"file": "../r.h5"}])
    with pytest.raises(InputError, match=r"\.\./r\.h5 is not in the folder"):
        verify(folder, dictionaries["cars"])
