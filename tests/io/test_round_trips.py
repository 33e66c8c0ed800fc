"""Whatever is written is read back, to the last bit, in each format a record has; of
the spellings that Unicode has of a name, the composed one.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from shapefit.dictionary.model import Dictionary
from shapefit.geometry.normalisation import MAX_COORDINATE
from shapefit.geometry.procrustes import coincide
from shapefit.io import (
    landmark_writer,
    open_landmarks,
    read_dictionary,
    read_results,
    read_shapes,
    result_writer,
    write_dictionary,
    write_shapes,
)
from shapefit.io.layout import PROOF
from shapefit.io.names import as_composed
from shapefit.io.source import open_results
from shapefit.records import Fit, Landmarks, Shapes, concatenate

finite = st.floats(-MAX_COORDINATE, MAX_COORDINATE)
positive = st.floats(0, exclude_min=True, allow_infinity=False)
anything = st.floats()
letters = st.characters(exclude_characters="\0", codec="utf-8")
texts = st.text(letters, max_size=6).map(as_composed)
names = st.text(letters, min_size=1, max_size=6).map(as_composed)


def optional(strategy):
    return st.none() | strategy


def distinct(size):
    return st.lists(names, min_size=size, max_size=size, unique=True).map(tuple)


def numbers(shape, elements=finite):
    return arrays(np.float64, shape, elements=elements)


def indices(columns, size):
    """Pairs or triples of indices that are smaller than `size`."""
    return arrays(
        np.int64, (2 if size else 0, columns), elements=st.integers(0, max(size - 1, 0))
    )


@st.composite
def sizes(draw):
    """Sizes of a record, and the fields that all records have."""
    n = draw(st.integers(0, 4))
    p = draw(st.integers(1 if n else 0, 3))
    common = {
        "landmark_names": draw(distinct(p)),
        "items": draw(distinct(n)),
        "sequences": draw(optional(st.lists(texts, min_size=n, max_size=n).map(tuple))),
        "unit": draw(names),
        "extras": {
            **draw(
                st.fixed_dictionaries({}, optional={"turn": numbers((n, 2), anything)})
            ),
        },
        "file_extras": draw(
            st.fixed_dictionaries({}, optional={"matrix": numbers((3, 3), anything)})
        ),
    }
    return n, p, common


@st.composite
def shape_sets(draw):
    n, p, common = draw(sizes())
    q = draw(st.integers(1, 4))
    return Shapes(
        draw(numbers((n, p, 3))),
        edges=draw(optional(indices(2, p))),
        mesh_vertices=draw(numbers((n, q, 3))),
        mesh_faces=draw(optional(indices(3, q))),
        **common,
    )


@st.composite
def landmark_sets(draw):
    n, p, common = draw(sizes())
    points = draw(numbers((n, p, 2)))
    hidden = draw(arrays(np.bool_, (n, p, 1)))
    return Landmarks(
        np.where(hidden, np.nan, points),
        confidence=draw(optional(numbers((n, p), st.floats(0, allow_infinity=False)))),
        y_axis=draw(st.sampled_from(["up", "down"])),
        **common,
    )


@st.composite
def result_sets(draw):
    n, p, common = draw(sizes())
    k = draw(st.integers(0, 3))
    shapes = draw(numbers((n, p, 3)))
    failed = draw(arrays(np.bool_, (n, 1, 1)))
    status = arrays(
        np.dtype("U6"), n, elements=st.sampled_from(["solved", "failed", ""])
    )
    counts = draw(arrays(np.int64, n, elements=st.integers(0, k)))
    total = int(counts.sum())
    proof = {
        "dual": draw(numbers((n, p, 2))),
        "transform_count": counts,
        "transform_atom": draw(arrays(np.int64, total, elements=st.integers(0, k))),
        "active_transforms": draw(numbers((total, 2, 3))),
    }
    return Fit(
        np.where(failed, np.nan, shapes),
        landmarks_fitted=draw(optional(numbers((n, p, 2), anything))),
        coefficients=draw(optional(numbers((n, k), anything))),
        rotation=draw(optional(numbers((n, 3, 3), anything))),
        translation=draw(optional(numbers((n, 2), anything))),
        scale=draw(optional(numbers(n, anything))),
        objective=draw(optional(numbers(n, anything))),
        relative_gap=draw(optional(numbers(n, anything))),
        iterations=draw(optional(arrays(np.int64, n))),
        status=draw(optional(status)),
        transforms=draw(optional(numbers((n, k, 2, 3), anything))),
        mesh_vertices=draw(optional(numbers((n, 2, 3), anything))),
        y_axis=draw(st.sampled_from(["up", "down"])),
        attributes=draw(attributes(st.integers(-9, 9) | finite | texts)),
        **common,
        **proof if draw(st.booleans()) else {},
    )


def attributes(values):
    known = st.sampled_from(["method", "version", "format", "unit", "y_axis", "inputs"])
    return st.dictionaries(known, values)


@st.composite
def dictionaries(draw):
    k, p, q = (draw(st.integers(1, 3)) for _ in range(3))
    p += 1
    return Dictionary(
        atoms=draw(numbers((k, 3, p))),
        landmark_names=draw(distinct(p)),
        mean_shape=draw(numbers((3, p)).filter(lambda mean: not coincide(mean))),
        edges=draw(optional(indices(2, p))),
        mesh_vertices=draw(numbers((k, 3, q))),
        mesh_faces=draw(optional(indices(3, q))),
        atom_scale=draw(optional(numbers(k, positive))),
        unit=draw(names),
        atom_items=draw(optional(st.lists(names, min_size=k, max_size=k).map(tuple))),
        objective_trace=draw(numbers(draw(st.integers(0, 3)))),
        provenance=draw(attributes(texts)),
    )


@pytest.fixture(scope="module")
def folder():
    with TemporaryDirectory() as path:
        yield Path(path)


def check_table(same, found, record, retained):
    """A table keeps these fields, as far as there is an item that has them."""
    if not len(record):
        assert len(found) == 0
        return
    bare = {name: getattr(record, name) for name in retained}
    same(found, type(record)(**bare))


@settings(deadline=None, max_examples=15)
@given(record=shape_sets())
def test_shapes(folder, same, record):
    write_shapes(folder / "shapes.h5", record)
    same(read_shapes([folder / "shapes.h5"]), record)
    retained = {"shapes", "landmark_names", "items", "sequences"}
    write_shapes(folder / "shapes.csv", record)
    check_table(same, read_shapes([folder / "shapes.csv"]), record, retained)


@settings(deadline=None, max_examples=15)
@given(record=landmark_sets(), size=st.integers(1, 5))
def test_landmarks(folder, same, record, size):
    retained = {"landmarks", "confidence", "landmark_names", "items", "sequences"}
    record = record.with_points(record.landmarks + 10.0)  # no fractions of an image
    for suffix in ("h5", "csv"):
        path = folder / f"views.{suffix}"
        with landmark_writer(path) as writer:
            for start in range(0, max(len(record), 1), size):
                writer.append(record.take(slice(start, start + size)))
        with open_landmarks([path]) as source:
            found = concatenate(list(source.batches(size)))
        if suffix == "h5":
            same(found, record)
        else:
            check_table(same, found, record, retained)


@settings(deadline=None, max_examples=15)
@given(record=result_sets(), size=st.integers(1, 5))
def test_results(folder, same, record, size):
    retained = {"shapes", "landmark_names", "items", "sequences"}
    for suffix in ("h5", "csv"):
        path = folder / f"result.{suffix}"
        with result_writer(path) as writer:
            for start in range(0, max(len(record), 1), size):
                writer.append(record.take(slice(start, start + size)))
        if suffix == "h5":
            with open_results([path], ()) as source:
                same(concatenate(list(source.batches(3))), record)
            same(read_results(path), record.without(PROOF))
        else:
            check_table(same, read_results(path), record, retained)


@settings(deadline=None, max_examples=15)
@given(dictionary=dictionaries())
def test_dictionary(folder, same, dictionary):
    write_dictionary(folder / "dict.h5", dictionary)
    same(read_dictionary(folder / "dict.h5"), dictionary)


@pytest.mark.parametrize("suffix", ["h5", "csv"])
def test_chunks_of_a_file_must_go_together(tmp_path, landmarks, suffix):
    def write(*chunks):
        with landmark_writer(tmp_path / f"views.{suffix}") as writer:
            for chunk in chunks:
                writer.append(chunk)

    others = [landmarks.replaced(confidence=None)]
    if suffix == "h5":
        others += [
            landmarks.replaced(landmark_names=tuple("abcd")),
            landmarks.replaced(extras={}),
        ]
    for other in others:
        with pytest.raises(ValueError, match="not those of the first"):
            write(landmarks, other)
    with pytest.raises(ValueError, match="nothing was appended"):
        write()
    assert not list(tmp_path.iterdir())
