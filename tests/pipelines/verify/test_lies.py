"""What is planted in a result, or in a folder of results, is found."""

import hashlib
import json
import os
import shutil

import h5py
import numpy as np
import pytest

from shapefit.errors import InputError
from shapefit.io import read_results, result_writer
from tests.pipelines.verify.conftest import TERMS

IMAGE = 3

CASES = {
    **{loss: ("people", term) for loss, term in TERMS.items()},
    "refined": ("people", {"method": "convex+refine"}),
    "global": ("people", {"method": "global"}),
    "left out": ("cars", {"lam": 1.0, "leave_one_out": "true_model"}),
    "posterior": ("walk", {"method": "posterior"}),
}
"""Kinds of results."""


def entry(name, other, row=IMAGE):
    """Return the lie that the numbers of an image in a dataset are `other` of what they
    are.
    """

    def lie(file):
        file[name][row] = other(file[name][row])

    return lie


def everywhere(name, other):
    """Return the lie that a dataset is `other` of what it is."""

    def lie(file):
        file[name][()] = other(file[name][()])

    return lie


def gone(*names):
    """Return the lie that datasets are not there."""

    def lie(file):
        for name in names:
            del file[name]

    return lie


def states(**values):
    """Return the lie that attributes have other values."""

    def lie(file):
        file.attrs.update(values)

    return lie


def in_config(**values):
    """Return the lie that the config has other keys, with a digest that fits."""

    def lie(file):
        config = json.loads(file.attrs["config"])
        text = json.dumps(config | values)
        file.attrs["config"] = text
        file.attrs["config_digest"] = hashlib.sha256(text.encode()).hexdigest()

    return lie


def without_inputs(file):
    del file.attrs["inputs"]


@pytest.fixture
def changed_case(fitted, changed):
    """Return a result of a case with a lie in it."""

    def change(case, lie):
        kind, keys = CASES[case]
        return changed(fitted(kind, **keys), lie)

    return change


def withhold_shape(file):
    """Say that an image has no scale, and so no shape."""
    file["scale"][IMAGE] = np.nan


LIES = {
    "gap smaller": ("squared", entry("relative_gap", lambda gap: gap - 1e-7)),
    "gap smaller, l1": ("l1", entry("relative_gap", lambda gap: gap - 1e-7)),
    "gap withheld": ("squared", gone("relative_gap")),
    "gap of the refined": ("refined", entry("relative_gap", lambda gap: 0.9 * gap)),
    "objective": ("squared", entry("objective", lambda P: P * (1 - 1e-7))),
    "objective of the refined": (
        "refined",
        entry("objective", lambda P: P * (1 - 1e-7)),
    ),
    "dual infeasible": ("squared", entry("dual", lambda Y: Y * (1 + 1e-7))),
    "dual unbalanced": ("squared", entry("dual", lambda Y: Y + 1e-7)),
    "dual beyond its bound": ("l1", entry("dual", lambda Y: np.sign(Y) * 1.01)),
    "shape": ("squared", entry("shapes", lambda S: S + 1e-4)),
    "shape of the refined": ("refined", entry("shapes", lambda S: S * (1 + 1e-6))),
    "translation": ("squared", entry("translation", lambda x: x + 1e-4)),
    "lambda": ("squared", entry("lambda", lambda lam: 1.0001 * lam)),
    "status raised": ("squared", in_config(tolerance=1e-12)),
    "shape withheld": ("squared", withhold_shape),
    "landmarks": ("posterior", entry("landmarks", lambda x: x + 1e-9)),
    "confidence": ("posterior", entry("confidence", lambda c: 0.99 * c)),
    "bars negative": ("posterior", everywhere("shape_sd", np.negative)),
    "bars infinite": ("posterior", everywhere("shape_sd", lambda sd: sd + np.inf)),
    "correlation": ("posterior", everywhere("shape_correlation", lambda r: 5 + r)),
    "chance": ("posterior", everywhere("p_value", lambda p: 17 + p)),
    "scale": ("posterior", everywhere("scale", lambda scale: 0 * scale)),
    "rotation of zeros": ("global", everywhere("rotation", lambda R: 0 * R)),
    "rotation mirrored": ("squared", everywhere("rotation", np.negative)),
    "verdict gone": ("posterior", gone("trusted")),
    "reasons gone": ("posterior", gone("reasons")),
    "dual gone": ("squared", gone("dual")),
    "inputs gone": ("squared", without_inputs),
    "inputs without digests": ("squared", states(inputs="{}")),
    "config of another digest": ("squared", states(config_digest="0" * 64)),
}
"""What is planted -> in which kind of result, and how."""


@pytest.mark.parametrize("name", LIES)
def test_a_lie_is_found(changed_case, verify, dictionaries, landmarks, name):
    case, lie = LIES[name]
    kind, _ = CASES[case]
    result = changed_case(case, lie)
    found = verify(result, dictionaries[kind], [landmarks[kind]])
    nothing_false = f"False      0 of {found.done} images"
    assert found.failures
    assert found.data["false"] + found.data["files"] == len(found.failures)
    assert found.note.splitlines()[-1] != nothing_false


def confidence_of_images(file):
    """Replace the confidences by one number an image."""
    n = len(file["item"])
    del file["confidence"]
    file["confidence"] = np.full(n, 0.5)


def confidence_in_words(file):
    values = np.full(file["confidence"].shape, b"sure")
    del file["confidence"]
    file["confidence"] = values


@pytest.mark.parametrize("lie", [confidence_of_images, confidence_in_words])
def test_confidences_that_are_no_number_a_landmark_are_refused(
    changed_case, verify, dictionaries, lie
):
    result = changed_case("posterior", lie)
    with pytest.raises(InputError, match=r"/confidence: holds .*; store numbers \("):
        verify(result, dictionaries["walk"])


def test_the_atoms_of_a_left_out_item_are_not_used(changed_case, verify, dictionaries):
    with h5py.File(dictionaries["cars"]) as file:
        names = file["atom_item"].asstr()[()].tolist()

    def use(file):
        omitted = file["omitted"].asstr()[IMAGE]
        row = int(file["transform_count"][:IMAGE].sum())
        file["transform_atom"][row] = names.index(omitted)

    result = changed_case("left out", use)
    assert verify(result, dictionaries["cars"]).failures


def test_what_was_left_out_is_compared(changed_case, verify, dictionaries):
    result = changed_case("left out", everywhere("omitted", np.zeros_like))
    assert verify(result, dictionaries["cars"]).failures


def test_another_dictionary_is_found(fitted, verify, dictionaries):
    other = dictionaries["other people"]
    found = verify(fitted("people"), other)
    assert "the digests differ" in found.failures[str(other)]
    assert found.data["false"] == found.done


def test_the_dictionary_of_another_class_is_refused(fitted, verify, dictionaries):
    with pytest.raises(InputError, match="landmark"):
        verify(fitted("people"), dictionaries["cars"])


@pytest.fixture
def other_landmarks(landmarks, tmp_path):
    """The landmarks of people, of which one has another x; and its item."""
    path = tmp_path / "views.csv"
    header, first, *rows = landmarks["people"].read_text().splitlines()
    item, name, x, *others = first.split(",")
    changed = ",".join([item, name, str(float(x) + 0.1), *others])
    path.write_text("\n".join([header, changed, *rows, ""]))
    return path, item


def test_other_landmarks_are_found(fitted, verify, dictionaries, other_landmarks):
    path, item = other_landmarks
    found = verify(fitted("people"), dictionaries["people"], [path])
    assert set(found.failures) == {str(path), item}


def test_the_file_of_the_fit_is_known_by_its_digest(
    fitted, verify, dictionaries, landmarks, other_landmarks, tmp_path
):
    """Whatever its name."""
    other, _ = other_landmarks
    same = shutil.copy(landmarks["people"], tmp_path / "renamed.csv")
    found = verify(fitted("people"), dictionaries["people"], [other, same])
    assert found.failures == {}


@pytest.fixture
def of_two_files(changed, fitted, landmarks):
    """A result that states a second file of landmarks beside that of its fit."""
    first = str(landmarks["people"])
    of_two = in_config(landmarks=[first, "second.csv"])

    def lie(file):
        of_two(file)
        inputs = json.loads(file.attrs["inputs"])
        inputs["second.csv"] = "0" * 64
        file.attrs["inputs"] = json.dumps(inputs)

    return changed(fitted("people", outliers="none"), lie)


def test_the_file_of_several_that_is_not_given_is_named(
    of_two_files, verify, dictionaries, landmarks
):
    found = verify(of_two_files, dictionaries["people"], [landmarks["people"]])
    fault = "is a file of the fit that is not given by --landmarks"
    assert found.failures["second.csv"] == fault
    assert str(landmarks["people"]) not in found.failures


def test_without_landmarks_none_of_several_is_missed(
    of_two_files, verify, dictionaries
):
    found = verify(of_two_files, dictionaries["people"])
    assert "second.csv" not in found.failures


WRONG = [
    *(
        states(config=text)
        for text in ("", "[]", "{}", "no", '{"method": "convex"}', "[" * 60_000)
    ),
    *(
        in_config(**keys)
        for keys in ({"landmarks": 3}, {"method": "magic"}, {"tolerance": "fine"})
    ),
    *(in_config(**keys) for keys in ({"rename": 5}, {"keypoints": 7})),
    *(entry("transform_count", lambda n, by=wrong: n + by) for wrong in (-1, 1, 10**6)),
]


@pytest.mark.parametrize("lie", WRONG)
def test_what_is_no_result_of_a_fit_is_refused(
    fitted, changed, verify, dictionaries, landmarks, lie
):
    """With exit code 2, and not as an internal error."""
    result = changed(fitted("people"), lie)
    with pytest.raises(InputError):
        verify(result, dictionaries["people"], [landmarks["people"]])


def test_no_images_are_a_failure(fitted, verify, dictionaries, tmp_path):
    path = tmp_path / "none.h5"
    result = read_results(fitted("people"), proofs=True)
    with result_writer(path) as writer:
        writer.append(result.take(slice(0)))
    found = verify(path, dictionaries["people"])
    assert "holds no image" in "".join(found.failures.values())
    assert found.note == "No image was checked."


def edit(folder, change):
    """Change the lines of the manifest about parts."""
    path = folder / "manifest.jsonl"
    run, *parts = map(json.loads, path.read_text().splitlines())
    lines = [json.dumps(line) for line in [run, *change(parts)]]
    path.write_text("\n".join([*lines, ""]))


def exchange(folder):
    one = folder / "part-00000.h5"
    two = folder / "part-00001.h5"
    one.rename(folder / "third")
    two.rename(one)
    (folder / "third").rename(two)


def lose_file(folder):
    (folder / "part-00001.h5").unlink()


def add_file(folder):
    shutil.copy(folder / "part-00001.h5", folder / "part-00002.h5")


def no_parts(folder):
    edit(folder, lambda _: [])


def shift_rows(folder):
    def shift(parts):
        for part in parts:
            start, stop = part["rows"]
            yield part | {"rows": [start + 1, stop + 1]}

    edit(folder, shift)


def replace_by_a_pipe(folder):
    lose_file(folder)
    os.mkfifo(folder / "part-00001.h5")


LIES_OF_FOLDERS = [
    exchange,
    lose_file,
    add_file,
    no_parts,
    shift_rows,
    replace_by_a_pipe,
]


@pytest.mark.parametrize(
    "lie", LIES_OF_FOLDERS, ids=[lie.__name__ for lie in LIES_OF_FOLDERS]
)
def test_a_changed_folder_is_found(folder, verify, dictionaries, landmarks, lie):
    lie(folder)
    try:
        assert verify(folder, dictionaries["cars"], [landmarks["cars"]]).failures
    except InputError:
        assert lie in (
            shift_rows,
            exchange,
        )  # as many rows as no part has, or not in the file


def test_other_landmarks_of_a_divided_file_are_found(
    folder, verify, dictionaries, landmarks
):
    """Parts of one file are compared with their rows of it, each."""
    other = folder.parent / landmarks["cars"].name
    shutil.copy(landmarks["cars"], other)
    honest = verify(folder, dictionaries["cars"], [other])
    with h5py.File(other, "r+") as file:
        rows = [3, 100]
        names = file["item"].asstr()[rows].tolist()
        file["landmarks"][rows] += 1.0
    found = verify(folder, dictionaries["cars"], [other])
    assert honest.failures == {}
    assert set(names) <= set(found.failures)
    assert found.data["false"] == 2


def damage(part):
    data = bytearray(part.read_bytes())
    data[2000:12000] = bytes(10000)
    part.write_bytes(data)


@pytest.mark.parametrize(("number", "left"), [(0, 44), (1, 64)])
def test_a_damaged_part_is_named_and_the_others_are_checked(
    folder, verify, dictionaries, number, left
):
    part = folder / f"part-0000{number}.h5"
    damage(part)
    found = verify(folder, dictionaries["cars"])
    assert found.done == left
    assert "cannot be read" in found.failures[str(part)]
    assert f"Certified  {left} of 108 images" in found.note


def test_a_folder_of_damaged_parts_is_refused(folder, verify, dictionaries):
    for part in folder.glob("part-*"):
        damage(part)
    with pytest.raises(InputError):
        verify(folder, dictionaries["cars"])


@pytest.mark.parametrize(
    "text", ["", "[]\n", "{}\n", '{"config": "", "dictionary": ""}\n{}\n']
)
def test_what_is_no_manifest_is_refused(folder, verify, dictionaries, text):
    (folder / "manifest.jsonl").write_text(text)
    with pytest.raises(InputError, match="is not a manifest of results"):
        verify(folder, dictionaries["cars"])


def test_a_part_outside_of_the_folder_is_refused(folder, verify, dictionaries):
    shutil.copy(folder / "part-00001.h5", folder.parent / "r.h5")
    edit(folder, lambda parts: [parts[0], parts[1] | {"file": "../r.h5"}])
    with pytest.raises(InputError, match="is not a manifest of results"):
        verify(folder, dictionaries["cars"])
