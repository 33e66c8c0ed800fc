"""Every edit of a result that leaves its stored digest is found, and no edit ends in an
internal error.
"""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io.contents import digest_contents
from shapefit.io.layout import CONTENTS
from tests.pipelines.verify.conftest import is_accepted

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


def delete(file: h5py.File, name: str) -> None:
    del file[name]


def state(file: h5py.File, name: str, value: Any) -> None:
    """Give the file this attribute."""
    file.attrs[name] = value


def forget(file: h5py.File, name: str) -> None:
    """Delete this attribute of the file."""
    del file.attrs[name]


def annotate(file: h5py.File, name: str) -> None:
    """Give a dataset an attribute that it has not."""
    file[name].attrs["a"] = 1


def other_numbers(values: np.ndarray) -> dict[str, np.ndarray]:
    little = values.copy()
    first = np.nan_to_num(values.flat[0])
    little.flat[0] = np.nextafter(first, 9.0)
    infinite = values.copy()
    infinite.flat[-1] = -np.inf
    return {
        "a little": little,
        "nan": np.full_like(values, np.nan),
        "infinite": infinite,
    }


def other_texts(values: np.ndarray) -> dict[str, np.ndarray]:
    longer = values.astype(object)
    longer.flat[0] += b"x"
    return {"a little": longer.astype("S")}


def other_integers(values: np.ndarray) -> dict[str, np.ndarray]:
    """Integers, or truth values."""
    other = values.copy()
    is_bool = values.dtype.kind == "b"
    other.flat[0] = ~values.flat[0] if is_bool else 1
    other.flat[-1] = 0
    return {"a little": other}


OTHER_VALUES = {"f": other_numbers, "O": other_texts, "S": other_texts}
"""Kind of values -> what they may become in their shape; others are integers."""


def edits_of_dataset(name: str, values: np.ndarray) -> Iterator[tuple[str, Edit]]:
    other_shapes = {
        "with an axis": values[..., None],
        "narrower": values[..., :-1],
        "as text": np.full(values.shape, b"text"),
        "shorter": values[:-1],
    }
    others = OTHER_VALUES.get(values.dtype.kind, other_integers)(values)
    yield f"{name} deleted", partial(delete, name=name)
    for word, new in (other_shapes | others).items():
        if not np.array_equal(new, values):
            yield f"{name} {word}", partial(put, name=name, values=new)


def edits_of_attribute(name: str, value: Any) -> Iterator[tuple[str, Edit]]:
    is_text = isinstance(value, str | bytes)
    other = f"{value} " if is_text else value + 1
    yield f"@{name} deleted", partial(forget, name=name)
    for new in (other, np.nan, "", [1.0, 2.0]):
        yield f"@{name} {new!r:.20}", partial(state, name=name, value=new)


ADDED = {
    "a new dataset": lambda file: file.create_dataset("stranger", data=np.arange(3)),
    "a new group": lambda file: file.create_group("further/deep"),
    "a new attribute": lambda file: file.attrs.update(note="fine"),
    "a link": lambda file: file.__setitem__("soft", h5py.SoftLink("/shapes")),
    "a second name": lambda file: file.__setitem__("hard", file["shapes"]),
}


def edits_of(path: Path) -> dict[str, Edit]:
    """Edits of each dataset and attribute: a little, to NaN, or gone."""
    with h5py.File(path) as file:
        datasets = {name: node[()] for name, node in file.items()}
        attributes = dict(file.attrs)
    del attributes[CONTENTS]
    edits = {}
    for name, values in datasets.items():
        edits.update(edits_of_dataset(name, values))
    for name, value in attributes.items():
        edits.update(edits_of_attribute(name, value))
    for name in datasets:
        edits[f"{name}@new"] = partial(annotate, name=name)
    return edits | ADDED


@pytest.fixture(params=CASES)
def case(request, fitted, dictionaries, landmarks):
    """A result, its dictionary and its landmarks."""
    kind, keys = CASES[request.param]
    return fitted(kind, **keys), dictionaries[kind], [landmarks[kind]]


@pytest.fixture(params=[13, pytest.param(1, marks=pytest.mark.slow)])
def edits(request, case):
    """All edits of a result, or in a quick test every thirteenth."""
    result, _, _ = case
    every = edits_of(result)
    assert len(every) > 80
    names = list(every)[:: request.param]
    return {name: every[name] for name in names}


def test_without_an_edit_a_result_is_accepted(verify, case):
    result, dictionary, landmarks = case
    assert is_accepted(verify, result, dictionary, [])
    assert is_accepted(verify, result, dictionary, landmarks)


def test_every_edit_is_found(changed, verify, case, edits):
    result, dictionary, _ = case
    accepted = []
    for name, edit in edits.items():
        edited = changed(result, edit, seal=False)
        if is_accepted(verify, edited, dictionary, []):
            accepted.append(name)
    assert accepted == []


def test_no_edit_ends_in_an_internal_error(changed, verify, case, edits):
    """Under a digest that fits, each runs through the recomputation, which must bear
    it.
    """
    result, dictionary, landmarks = case
    for name, edit in edits.items():
        sealed = changed(result, edit)
        try:
            verify(sealed, dictionary, landmarks)
        except InputError:
            continue
        except Exception as error:
            raise AssertionError(name) from error


def reset_rotations(file: h5py.File) -> None:
    """Each is the identity."""
    shape = file["rotation"].shape
    put(file, "rotation", np.broadcast_to(np.eye(3), shape))


def reverse_names(file: h5py.File) -> None:
    names = file["landmark_names"][()]
    put(file, "landmark_names", names[::-1])


CLAIMED = {
    "y_axis flipped": partial(state, name="y_axis", value="up"),
    "unit changed": partial(state, name="unit", value="mm"),
    "frame rate doubled": partial(state, name="frame_rate", value=48.0),
    "rotation is the identity": reset_rotations,
    "other names": reverse_names,
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
    result = changed(fitted("people"), partial(forget, name=CONTENTS))
    found = verify(result, dictionaries["people"])
    assert found.failures == {}
    assert found.data["sealed"] == 0
    assert "not sealed" in found.note


def repack(old: h5py.File, new: h5py.File) -> None:
    """Copy in other chunks, compressed and in another order."""
    for name in sorted(old, reverse=True):
        node = old[name]
        is_text = h5py.check_string_dtype(node.dtype) is not None
        copied = new.create_dataset(
            name,
            data=node[()].astype(object) if is_text else node[()],
            dtype=h5py.string_dtype() if is_text else node.dtype,
            chunks=tuple(max(1, size // 3) for size in node.shape),
            compression="gzip",
        )
        copied.attrs.update(node.attrs)
    new.attrs.update(old.attrs)


def test_the_digest_is_of_values_alone(fitted, tmp_path):
    source = fitted("walk", method="posterior")
    target = tmp_path / "repacked.h5"
    with h5py.File(source) as old, h5py.File(target, "w") as new:
        repack(old, new)
        found = digest_contents(new, lambda name, rows: new[name][rows])
        assert found == old.attrs[CONTENTS]


def test_the_summary_says_what_was_recomputed(fitted, verify, dictionaries):
    result = fitted("people")
    with h5py.File(result) as file:
        gap = file["relative_gap"][()].max()
    found = verify(result, dictionaries["people"])
    assert found.data["largest_gap"] == gap
    assert f"{gap:.1g} at most" in found.note
    assert "Recomputed objective, gap and certificate" in found.note


def test_the_summary_says_whether_landmarks_were_compared(
    fitted, verify, dictionaries, landmarks
):
    result = fitted("people")
    compared = verify(result, dictionaries["people"], [landmarks["people"]])
    alone = verify(result, dictionaries["people"])
    assert "landmarks with the files" in compared.note
    assert "landmarks, without --landmarks" in alone.note


def test_the_summary_says_that_nothing_was_recomputed(fitted, verify, dictionaries):
    result = fitted("walk", method="posterior")
    found = verify(result, dictionaries["walk"])
    assert "Recomputed nothing" in found.note
    assert "how shapes, error bars and all other numbers follow" in found.note
