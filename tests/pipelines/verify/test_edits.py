"""Every edit of a result that leaves its stored digest is found, and no edit ends in an
internal error.
"""

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.config.paths import ResultFolder
from shapefit.errors import InputError
from shapefit.io.contents import digest_contents
from shapefit.io.layout import CONTENTS
from shapefit.pipelines.partition.run import fit_parts
from tests.pipelines.verify.conftest import reseal

Edit = Callable[[Any], object]

CASES = {
    "convex": ("people", {}),
    "refined": ("people", {"method": "convex+refine"}),
    "left out": ("cars", {"lam": 1.0, "leave_one_out": "true_model"}),
    "posterior": ("walk", {"method": "posterior"}),
}


def put(file: h5py.File, name: str, values: Any) -> None:
    """Write a dataset anew, with its attributes."""
    kept = dict(file[name].attrs)
    del file[name]
    file[name] = values
    file[name].attrs.update(kept)


def edits_of(path: Path) -> Iterator[tuple[str, Edit]]:
    """Yield an edit of each dataset and attribute: a little, to NaN, or gone."""
    with h5py.File(path) as file:
        datasets = {name: node[()] for name, node in file.items()}
        attributes = {name: file.attrs[name] for name in file.attrs}
    for name, values in datasets.items():
        yield f"{name} deleted", lambda file, name=name: file.__delitem__(name)
        yield (
            f"{name} with an axis",
            lambda file, name=name, values=values: put(file, name, values[..., None]),
        )
        yield (
            f"{name} narrower",
            lambda file, name=name, values=values: put(file, name, values[..., :-1]),
        )
        yield (
            f"{name} as text",
            lambda file, name=name, values=values: put(
                file, name, np.full(values.shape, b"text")
            ),
        )
        yield (
            f"{name} shorter",
            lambda file, name=name, values=values: put(file, name, values[:-1]),
        )
        if values.dtype.kind == "f":
            other = values.copy()
            other.flat[0] = np.nextafter(np.nan_to_num(other.flat[0]), 9.0)
            nothing = np.full_like(values, np.nan)
            infinite = values.copy()
            infinite.flat[-1] = -np.inf
            changes = {"a little": other, "nan": nothing, "infinite": infinite}
        elif values.dtype.kind in "OS":
            other = values.astype(object)
            other.flat[0] = other.flat[0] + b"x"
            changes = {"a little": other.astype("S")}
        else:
            other = values.copy()
            other.flat[0] = ~other.flat[0] if other.dtype.kind == "b" else 1
            other.flat[-1] = 0
            changes = {"a little": other}
        for word, new in changes.items():
            if new.shape != values.shape or not np.array_equal(new, values):
                yield (
                    f"{name} {word}",
                    lambda file, name=name, new=new: put(file, name, new),
                )
    for name, value in attributes.items():
        if name == CONTENTS:
            continue
        yield f"@{name} deleted", lambda file, name=name: file.attrs.__delitem__(name)
        other = f"{value} " if isinstance(value, str | bytes) else value + 1
        for new in (other, np.nan, "", [1.0, 2.0]):
            yield (
                f"@{name} {new!r:.20}",
                lambda file, name=name, new=new: file.attrs.__setitem__(name, new),
            )
    for name in datasets:
        yield f"{name}@new", lambda file, name=name: file[name].attrs.update(a=1)
    yield "a new dataset", lambda file: file.__setitem__("stranger", np.arange(3))
    yield "a new group", lambda file: file.create_group("further/deep")
    yield "a new attribute", lambda file: file.attrs.update(note="fine")
    yield "a link", lambda file: file.__setitem__("soft", h5py.SoftLink("/shapes"))
    yield "a second name", lambda file: file.__setitem__("hard", file["shapes"])


def is_accepted(verify: Any, *given: Any) -> bool:
    try:
        return not verify(*given).failures
    except InputError:
        return False


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("step", [13, pytest.param(1, marks=pytest.mark.slow)])
def test_every_edit_is_found(
    fitted, changed, verify, dictionaries, landmarks, case, step
):
    """All of them, or in a quick test every thirteenth."""
    kind, keys = CASES[case]
    result = fitted(kind, **keys)
    every = list(edits_of(result))
    assert len(every) > 80
    edits = dict(every[::step])
    for given in ([], [landmarks[kind]]):
        assert is_accepted(verify, result, dictionaries[kind], given)
    accepted = []
    for name, edit in edits.items():
        edited = changed(result, edit, seal=False)
        if is_accepted(verify, edited, dictionaries[kind], []):
            accepted.append(name)
    assert not accepted
    # Under a digest that fits, each runs through the recomputation, which must bear it.
    for name, edit in edits.items():
        try:
            verify(changed(result, edit), dictionaries[kind], [landmarks[kind]])
        except InputError:
            continue
        except Exception as error:
            raise AssertionError(name) from error


CLAIMED = {
    "y_axis flipped": lambda file: file.attrs.update(y_axis="up"),
    "unit changed": lambda file: file.attrs.update(unit="mm"),
    "frame rate doubled": lambda file: file.attrs.update(frame_rate=48.0),
    "rotation is the identity": lambda file: put(
        file, "rotation", np.broadcast_to(np.eye(3), file["rotation"].shape)
    ),
    "other names": lambda file: put(
        file, "landmark_names", file["landmark_names"][()][::-1]
    ),
}


@pytest.mark.parametrize("name", CLAIMED)
def test_what_landmarks_do_not_show_is_found(
    fitted, changed, verify, dictionaries, landmarks, name
):
    result = changed(fitted("people"), CLAIMED[name], seal=False)
    found = verify(result, dictionaries["people"], [landmarks["people"]])
    assert "are not those that `fit` wrote" in found.failures["changed.h5: contents"]


def test_a_result_without_a_digest_is_not_sealed(fitted, changed, verify, dictionaries):
    """It is checked as far as that goes, and the summary says so."""
    result = changed(fitted("people"), lambda file: file.attrs.__delitem__(CONTENTS))
    found = verify(result, dictionaries["people"])
    assert found.failures == {}
    assert found.data["sealed"] == 0
    assert "not sealed" in found.note


def test_the_digest_is_of_values_alone(fitted, tmp_path):
    """Chunks, compression and the order of datasets do not change it."""
    source = fitted("walk", method="posterior")
    target = tmp_path / "repacked.h5"
    with h5py.File(source) as old, h5py.File(target, "w") as new:
        for name in sorted(old, reverse=True):
            node = old[name]
            chunks = tuple(max(1, size // 3) for size in node.shape)
            text = h5py.check_string_dtype(node.dtype) is not None
            new.create_dataset(
                name,
                data=node[()].astype(object) if text else node[()],
                dtype=h5py.string_dtype() if text else node.dtype,
                chunks=chunks,
                compression="gzip",
            )
            new[name].attrs.update(node.attrs)
        new.attrs.update(old.attrs)
        found = digest_contents(new, lambda name, rows: new[name][rows])
        assert found == old.attrs[CONTENTS]


def test_the_summary_says_what_was_done(fitted, verify, dictionaries, landmarks):
    result = fitted("people")
    with h5py.File(result) as file:
        gap = file["relative_gap"][()].max()
    found = verify(result, dictionaries["people"], [landmarks["people"]])
    assert found.data["largest_gap"] == gap
    assert f"{gap:.1g} at most" in found.note
    assert "Recomputed objective, gap and certificate" in found.note
    assert "landmarks with the files" in found.note
    found = verify(result, dictionaries["people"])
    assert "landmarks, without --landmarks" in found.note
    found = verify(fitted("walk", method="posterior"), dictionaries["walk"])
    assert "Recomputed nothing" in found.note
    assert "how shapes, error bars and all other numbers follow" in found.note


@pytest.fixture(scope="module")
def honest(dictionaries, landmarks, tmp_path_factory):
    """A folder with two parts of one file."""
    folder = tmp_path_factory.mktemp("parts") / "honest"
    config = FitConfig(
        landmarks=[str(landmarks["cars"])],
        dictionary=str(dictionaries["cars"]),
        output=ResultFolder(folder, 64),
    )
    list(fit_parts(config))
    return folder


@pytest.fixture
def folder(honest, tmp_path):
    shutil.copytree(honest, tmp_path / "folder")
    return tmp_path / "folder"


def lines_of(folder: Path) -> list[dict[str, Any]]:
    text = (folder / "manifest.jsonl").read_text()
    return [json.loads(line) for line in text.splitlines()]


def write_lines(folder: Path, lines: list[dict[str, Any]]) -> None:
    text = "".join(json.dumps(line) + "\n" for line in lines)
    (folder / "manifest.jsonl").write_text(text)


def double_with_a_line(folder):
    """The second part once more, as a third, with a line that fits."""
    shutil.copy(folder / "part-00001.h5", folder / "part-00002.h5")
    lines = lines_of(folder)
    write_lines(folder, [*lines, lines[2] | {"file": "part-00002.h5"}])


def double_as_other_rows(folder):
    shutil.copy(folder / "part-00001.h5", folder / "part-00002.h5")
    lines = lines_of(folder)
    other = {"file": "part-00002.h5", "rows": [108, 152]}
    write_lines(folder, [*lines, lines[2] | other])


def double_in_place(folder):
    """The first part also as the second, with the size and counts of the first."""
    shutil.copy(folder / "part-00000.h5", folder / "part-00001.h5")
    run, first, _ = lines_of(folder)
    write_lines(folder, [run, first, first | {"file": "part-00001.h5"}])


def swap_with_sizes(folder):
    one = folder / "part-00000.h5"
    two = folder / "part-00001.h5"
    one.rename(folder / "third")
    two.rename(one)
    (folder / "third").rename(two)
    run, *parts = lines_of(folder)
    for own, other in zip(parts, lines_of(folder)[:0:-1], strict=True):
        own |= {key: other[key] for key in ("bytes", "images", "digest")}
    write_lines(folder, [run, *parts])


def cut_with_its_line(folder):
    (folder / "part-00001.h5").unlink()
    write_lines(folder, lines_of(folder)[:-1])


def cut_the_first_with_its_line(folder):
    (folder / "part-00000.h5").unlink()
    run, _, second = lines_of(folder)
    write_lines(folder, [run, second])


def cut_images(folder):
    """The last images of a part, as if it had never had them, sealed anew."""
    part = folder / "part-00001.h5"
    with h5py.File(part, "r+") as file:
        count = len(file["item"])
        rows = int(file["transform_count"][:-4].sum())
        for name, node in file.items():
            if node.shape[:1] == (count,):
                node.resize(count - 4, axis=0)
            elif name in ("transform_atom", "active_transforms"):
                node.resize(rows, axis=0)
        reseal(file)
        digest = file.attrs[CONTENTS]
    run, first, second = lines_of(folder)
    size = part.stat().st_size
    changed = {"bytes": size, "images": count - 4, "digest": digest}
    write_lines(folder, [run, first, second | changed])


def lose_the_seal(folder):
    part = folder / "part-00001.h5"
    with h5py.File(part, "r+") as file:
        del file.attrs[CONTENTS]
    *others, last = lines_of(folder)
    write_lines(folder, [*others, last | {"bytes": part.stat().st_size}])


LIES = (
    double_with_a_line,
    double_as_other_rows,
    double_in_place,
    swap_with_sizes,
    cut_with_its_line,
    cut_the_first_with_its_line,
    cut_images,
    lose_the_seal,
)


@pytest.mark.parametrize("lie", LIES, ids=[lie.__name__ for lie in LIES])
def test_a_changed_folder_is_found_without_landmarks(folder, verify, dictionaries, lie):
    assert verify(folder, dictionaries["cars"]).failures == {}
    lie(folder)
    assert not is_accepted(verify, folder, dictionaries["cars"], [])


def test_a_part_alone_is_compared_with_its_rows(
    folder, verify, dictionaries, landmarks
):
    part = folder / "part-00001.h5"
    found = verify(part, dictionaries["cars"], [landmarks["cars"]])
    assert found.failures == {}
    assert found.done == 44


def test_what_is_converted_is_not_sealed(folder, verify, dictionaries, tmp_path):
    """It is not what `fit` wrote: an edited result does not get a digest that holds."""
    from shapefit.cli.main import run

    joined = tmp_path / "joined.h5"
    assert run(["convert", str(folder), "-o", str(joined), "-q"]) == 0
    found = verify(joined, dictionaries["cars"])
    assert found.failures == {}
    assert found.data["sealed"] == 0
