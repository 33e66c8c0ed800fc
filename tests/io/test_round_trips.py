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
from shapefit.geometry.procrustes import are_coincident
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
    """Two pairs or triples of indices that are smaller than `size`; none below 0."""
    count = 2 if size else 0
    below_size = st.integers(0, max(size - 1, 0))
    return arrays(np.int64, (count, columns), elements=below_size)


def a_name_each(size):
    """A name for each item, of which several may have the same."""
    return st.lists(texts, min_size=size, max_size=size).map(tuple)


def with_or_without(name, values):
    """A dictionary that may have this one field."""
    return st.fixed_dictionaries({}, optional={name: values})


@st.composite
def sizes(draw):
    """Sizes of a record, and the fields that all records have."""
    n = draw(st.integers(0, 4))
    p = draw(st.integers(1 if n else 0, 3))
    common = {
        "landmark_names": draw(distinct(p)),
        "items": draw(distinct(n)),
        "sequences": draw(optional(a_name_each(n))),
        "unit": draw(names),
        "extras": draw(with_or_without("turn", numbers((n, 2), anything))),
        "file_extras": draw(with_or_without("matrix", numbers((3, 3), anything))),
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
    weights = numbers((n, p), st.floats(0, allow_infinity=False))
    return Landmarks(
        np.where(hidden, np.nan, points),
        confidence=draw(optional(weights)),
        y_axis=draw(st.sampled_from(["up", "down"])),
        **common,
    )


@st.composite
def proofs(draw, n, p, k):
    """The dual variables of n items, and the transforms of their active atoms."""
    counts = draw(arrays(np.int64, n, elements=st.integers(0, k)))
    total = int(counts.sum())
    atoms = arrays(np.int64, total, elements=st.integers(0, k))
    return {
        "dual": draw(numbers((n, p, 2))),
        "transform_count": counts,
        "transform_atom": draw(atoms),
        "active_transforms": draw(numbers((total, 2, 3))),
    }


@st.composite
def result_sets(draw):
    n, p, common = draw(sizes())
    k = draw(st.integers(0, 3))
    shapes = draw(numbers((n, p, 3)))
    failed = draw(arrays(np.bool_, (n, 1, 1)))
    states = st.sampled_from(["solved", "failed", ""])
    status = arrays(np.dtype("U6"), n, elements=states)
    proof = draw(proofs(n, p, k))
    has_proof = draw(st.booleans())

    def any_numbers(*shape):
        return draw(optional(numbers(shape, anything)))

    return Fit(
        np.where(failed, np.nan, shapes),
        landmarks_fitted=any_numbers(n, p, 2),
        coefficients=any_numbers(n, k),
        rotation=any_numbers(n, 3, 3),
        translation=any_numbers(n, 2),
        scale=any_numbers(n),
        objective=any_numbers(n),
        relative_gap=any_numbers(n),
        iterations=draw(optional(arrays(np.int64, n))),
        status=draw(optional(status)),
        transforms=any_numbers(n, k, 2, 3),
        mesh_vertices=any_numbers(n, 2, 3),
        y_axis=draw(st.sampled_from(["up", "down"])),
        attributes=draw(attributes(st.integers(-9, 9) | finite | texts)),
        **common,
        **(proof if has_proof else {}),
    )


def attributes(values):
    known = st.sampled_from(["method", "version", "format", "unit", "y_axis", "inputs"])
    return st.dictionaries(known, values)


@st.composite
def dictionaries(draw):
    k = draw(st.integers(1, 3))
    p = draw(st.integers(2, 4))
    q = draw(st.integers(1, 3))
    mean_shapes = numbers((3, p)).filter(lambda mean: not are_coincident(mean))
    names_of_atoms = st.lists(names, min_size=k, max_size=k).map(tuple)
    trace = numbers(draw(st.integers(0, 3)))
    return Dictionary(
        atoms=draw(numbers((k, 3, p))),
        landmark_names=draw(distinct(p)),
        mean_shape=draw(mean_shapes),
        edges=draw(optional(indices(2, p))),
        mesh_vertices=draw(numbers((k, 3, q))),
        mesh_faces=draw(optional(indices(3, q))),
        atom_scale=draw(optional(numbers(k, positive))),
        unit=draw(names),
        atom_items=draw(optional(names_of_atoms)),
        objective_trace=draw(trace),
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


def write_in_chunks(opened, record, size):
    """Write so many items at a time; a record without items in one chunk."""
    with opened as writer:
        for start in range(0, max(len(record), 1), size):
            chunk = record.take(slice(start, start + size))
            writer.append(chunk)


def read_in_batches(opened, size):
    with opened as source:
        return concatenate(list(source.batches(size)))


some_examples = settings(deadline=None, max_examples=15)
FIELDS_OF_A_TABLE = {"shapes", "landmark_names", "items", "sequences"}


@some_examples
@given(record=shape_sets())
def test_shapes_in_hdf5(folder, same, record):
    path = folder / "shapes.h5"
    write_shapes(path, record)
    same(read_shapes([path]), record)


@some_examples
@given(record=shape_sets())
def test_shapes_in_a_table(folder, same, record):
    path = folder / "shapes.csv"
    write_shapes(path, record)
    check_table(same, read_shapes([path]), record, FIELDS_OF_A_TABLE)


def of_no_fractions(record):
    """Landmarks that cannot be taken for fractions of an image."""
    return record.with_points(record.landmarks + 10.0)


@some_examples
@given(record=landmark_sets().map(of_no_fractions), size=st.integers(1, 5))
def test_landmarks_in_hdf5(folder, same, record, size):
    path = folder / "views.h5"
    write_in_chunks(landmark_writer(path), record, size)
    found = read_in_batches(open_landmarks([path]), size)
    same(found, record)


@some_examples
@given(record=landmark_sets().map(of_no_fractions), size=st.integers(1, 5))
def test_landmarks_in_a_table(folder, same, record, size):
    path = folder / "views.csv"
    write_in_chunks(landmark_writer(path), record, size)
    found = read_in_batches(open_landmarks([path]), size)
    retained = {"landmarks", "confidence", "landmark_names", "items", "sequences"}
    check_table(same, found, record, retained)


@some_examples
@given(record=result_sets(), size=st.integers(1, 5))
def test_results_in_hdf5(folder, same, record, size):
    """Opened, they have their proofs; read whole, they are without them."""
    path = folder / "result.h5"
    write_in_chunks(result_writer(path), record, size)
    opened = read_in_batches(open_results([path], ()), 3)
    same(opened, record)
    same(read_results(path), record.without(PROOF))


@some_examples
@given(record=result_sets(), size=st.integers(1, 5))
def test_results_in_a_table(folder, same, record, size):
    path = folder / "result.csv"
    write_in_chunks(result_writer(path), record, size)
    check_table(same, read_results(path), record, FIELDS_OF_A_TABLE)


@some_examples
@given(dictionary=dictionaries())
def test_dictionary(folder, same, dictionary):
    path = folder / "dict.h5"
    write_dictionary(path, dictionary)
    same(read_dictionary(path), dictionary)


@pytest.fixture(params=["h5", "csv"])
def views(request, tmp_path):
    """A file to be written, alone in its folder."""
    return tmp_path / f"views.{request.param}"


def write_chunks(path, *chunks):
    with landmark_writer(path) as writer:
        for chunk in chunks:
            writer.append(chunk)


def check_chunks(path, *chunks):
    """These do not go together, and nothing is left of them."""
    with pytest.raises(ValueError, match="not those of the first"):
        write_chunks(path, *chunks)
    assert not list(path.parent.iterdir())


def test_chunks_of_a_file_all_have_weights_or_none_has(views, landmarks):
    check_chunks(views, landmarks, landmarks.replaced(confidence=None))


@pytest.mark.parametrize("change", [{"landmark_names": tuple("abcd")}, {"extras": {}}])
def test_chunks_of_a_file_have_the_same_columns(tmp_path, landmarks, change):
    check_chunks(tmp_path / "views.h5", landmarks, landmarks.replaced(**change))


def test_a_file_of_no_chunks_is_refused(views):
    with pytest.raises(ValueError, match="nothing was appended"):
        write_chunks(views)
    assert not list(views.parent.iterdir())
