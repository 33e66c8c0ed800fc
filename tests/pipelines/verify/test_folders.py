"""A folder of results is one claim: what its manifest states falsely is found, or named."""

import json
import shutil

import pytest

from shapefit.config import FitConfig
from shapefit.errors import InputError
from shapefit.pipelines.parts.run import run as fit
from shapefit.verification.folder import COMPARED, STATED


@pytest.fixture(scope="session")
def honest(dictionaries, landmarks, tmp_path_factory):
    """A folder with two parts of one file, and one with another lambda."""
    folders = {}
    for name, lam in (("honest", 1.0), ("other", 0.5)):
        folders[name] = tmp_path_factory.mktemp("parts") / name
        config = FitConfig(
            landmarks=[str(landmarks["cars"])],
            dictionary=str(dictionaries["cars"]),
            output=f"{folders[name]}/",
            partition=64,
            lam=lam,
        )
        list(fit(config))
    return folders


@pytest.fixture
def folder(honest, tmp_path):
    shutil.copytree(honest["honest"], tmp_path / "folder")
    return tmp_path / "folder"


def edit(folder, change):
    path = folder / "manifest.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def another(value):
    """Return another value of the same type, for any key of a manifest."""
    if isinstance(value, int | float):
        return value + 1
    if isinstance(value, str):
        return f"{value[::-1]}"
    if isinstance(value, dict):
        return value | {"last": "zzz"}
    return [another(value[0]), *value[1:]] if value else [["item", "reason"]]


@pytest.mark.parametrize("with_landmarks", [True, False])
def test_an_honest_folder_is_accepted(folder, verify, dictionaries, landmarks, with_landmarks):
    given = [landmarks["cars"]] if with_landmarks else []
    found = verify(folder, dictionaries["cars"], given)
    assert (found.done, found.failures) == (108, {})
    assert ("Not compared without" in found.note) == (not with_landmarks)


def test_every_key_of_a_manifest_has_a_fate(folder):
    content = json.loads((folder / "manifest.json").read_text())
    for where, keys in (("of the folder", content), ("of a part", content["parts"][0])):
        assert {*COMPARED[where], *STATED[where]} == set(keys)


@pytest.mark.parametrize("part", [0, 1])
@pytest.mark.parametrize("key", [*COMPARED["of a part"], *STATED["of a part"]])
def test_a_lie_of_a_part_is_found_or_named(folder, verify, dictionaries, landmarks, key, part):
    def lie(content):
        content["parts"][part][key] = another(content["parts"][part][key])

    edit(folder, lie)
    found = verify(folder, dictionaries["cars"], [landmarks["cars"]])
    assert found.failures if key in COMPARED["of a part"] else f"`{key}`" in found.note


@pytest.mark.parametrize("key", [*COMPARED["of the folder"], *STATED["of the folder"]])
def test_a_lie_of_the_folder_is_found_or_named(folder, verify, dictionaries, key):
    def lie(content):
        content[key] = content[key][::-1] if key == "parts" else another(content[key])

    edit(folder, lie)
    if key == "version":
        with pytest.raises(InputError, match="its version is 3"):
            verify(folder, dictionaries["cars"])
        return
    found = verify(folder, dictionaries["cars"])
    assert found.failures if key in COMPARED["of the folder"] else f"`{key}`" in found.note


def exchange(folder, other):
    one, two = folder / "part-00000.h5", folder / "part-00001.h5"
    one.rename(folder / "third")
    two.rename(one)
    (folder / "third").rename(two)


def exchange_with_entries(folder, other):
    exchange(folder, other)

    def swap(content):
        parts = content["parts"]
        parts[0]["file"], parts[1]["file"] = parts[1]["file"], parts[0]["file"]
        parts.reverse()

    edit(folder, swap)


def copy_over(folder, other):
    shutil.copy(folder / "part-00000.h5", folder / "part-00001.h5")

    def same(content):
        rest = {key: content["parts"][0][key] for key in ("images", "failed", "bytes", "items")}
        content["parts"][1].update(rest)

    edit(folder, same)


def cut_last(folder, other):
    edit(folder, lambda content: content["parts"].pop())


def cut_last_with_file(folder, other):
    cut_last(folder, other)
    (folder / "part-00001.h5").unlink()


def cut_first(folder, other):
    edit(folder, lambda content: content["parts"].pop(0))
    (folder / "part-00000.h5").unlink()


def lose_file(folder, other):
    (folder / "part-00001.h5").unlink()


def add_file(folder, other):
    shutil.copy(folder / "part-00001.h5", folder / "part-00002.h5")


def read_outside(folder, other):
    shutil.copy(folder / "part-00001.h5", folder.parent / "r.h5")
    edit(folder, lambda content: content["parts"][1].update(file="../r.h5"))


def another_lambda(folder, other):
    shutil.copy(other / "part-00001.h5", folder / "part-00001.h5")
    size = (folder / "part-00001.h5").stat().st_size
    edit(folder, lambda content: content["parts"][1].update(bytes=size))


def no_parts(folder, other):
    edit(folder, lambda content: content.update(parts=[]))


LIES = [
    exchange, exchange_with_entries, copy_over, cut_last, cut_last_with_file, cut_first, lose_file,
    add_file, read_outside, another_lambda, no_parts,
]  # fmt: skip


@pytest.mark.parametrize("lie", LIES, ids=[lie.__name__ for lie in LIES])
def test_a_changed_folder_is_found(folder, honest, verify, dictionaries, landmarks, lie):
    lie(folder, honest["other"])
    found = verify(folder, dictionaries["cars"], [landmarks["cars"]])
    assert found.failures
    if lie is lose_file:
        assert "Of 64 of 108 images: the optimum" in found.note
    if lie is not cut_last_with_file:  # which only the landmarks know
        assert verify(folder, dictionaries["cars"]).failures


def damage(part, first=20000):
    data = bytearray(part.read_bytes())
    data[first : first + 10000] = bytes(10000)
    part.write_bytes(data)


@pytest.mark.parametrize("number", [0, 1])
def test_a_damaged_part_is_named_and_the_others_are_checked(folder, verify, dictionaries, number):
    damage(folder / f"part-0000{number}.h5", 2000)
    found = verify(folder, dictionaries["cars"])
    ((part, reason),) = found.failures.items()
    assert (found.done, part) == ([44, 64][number], str(folder / f"part-0000{number}.h5"))
    assert reason.startswith("cannot be read")
    assert f"Of {found.done} of 108 images: the optimum" in found.note


def test_a_folder_of_damaged_parts_is_refused(folder, verify, dictionaries):
    for part in folder.glob("part-*"):
        damage(part, 2000)
    with pytest.raises(InputError) as found:
        verify(folder, dictionaries["cars"])
    assert [f"part-0000{number}.h5" in str(found.value) for number in (0, 1)] == [True, True]


def test_parts_outside_the_folder_are_never_read(folder, honest, verify, dictionaries):
    read_outside(folder, honest["other"])
    assert verify(folder, dictionaries["cars"]).done == 64
    with pytest.raises(ValueError, match="not in the folder"):
        FitConfig(landmarks=[str(folder)], dictionary=str(dictionaries["cars"]), output="o.h5")


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"parts": [{"file": "part-00000.h5"}]}'])
def test_what_is_no_manifest_is_refused(folder, verify, dictionaries, text):
    (folder / "manifest.json").write_text(text)
    with pytest.raises(InputError, match="is not a manifest of results"):
        verify(folder, dictionaries["cars"])
