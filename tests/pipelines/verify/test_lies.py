"""What is planted in a result, or in a folder of results, is found."""

import hashlib
import json
import os
import shutil

import h5py
import numpy as np
import pytest

from shapefit.config import FitConfig
from shapefit.config.paths import ResultFolder
from shapefit.errors import InputError
from shapefit.pipelines.partition.run import fit_parts
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
    return lambda file: file[name].__setitem__((), other(file[name][()]))


def gone(*names):
    return lambda file: [file.__delitem__(name) for name in names]


def states(**values):
    return lambda file: file.attrs.update(values)


def in_config(**values):
    """Return the lie that the config has other keys, with a digest that fits."""

    def lie(file):
        file.attrs["config"] = json.dumps(json.loads(file.attrs["config"]) | values)
        file.attrs["config_digest"] = hashlib.sha256(
            file.attrs["config"].encode()
        ).hexdigest()

    return lie


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
    "inputs gone": ("squared", lambda file: file.attrs.__delitem__("inputs")),
    "inputs without digests": ("squared", states(inputs="{}")),
    "config of another digest": ("squared", states(config_digest="0" * 64)),
}
"""What is planted -> in which kind of result, and how."""


@pytest.mark.parametrize("name", LIES)
def test_a_lie_is_found(fitted, changed, verify, dictionaries, landmarks, name):
    case, lie = LIES[name]
    kind, keys = CASES[case]
    found = verify(
        changed(fitted(kind, **keys), lie), dictionaries[kind], [landmarks[kind]]
    )
    assert found.failures
    assert found.data["false"] + found.data["files"] == len(found.failures)
    assert found.note.splitlines()[-1] != f"False      0 of {found.done} images"


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
    fitted, changed, verify, dictionaries, lie
):
    result = changed(fitted("walk", method="posterior"), lie)
    with pytest.raises(InputError, match=r"/confidence: holds .*; store numbers \("):
        verify(result, dictionaries["walk"])


def test_the_atoms_of_a_left_out_item_are_not_used(
    fitted, changed, verify, dictionaries
):
    def use(file):
        with h5py.File(dictionaries["cars"]) as own:
            names = own["atom_item"].asstr()[()].tolist()
        row = int(file["transform_count"][:IMAGE].sum())
        file["transform_atom"][row] = names.index(file["omitted"].asstr()[IMAGE])

    for lie in (use, everywhere("omitted", np.zeros_like)):
        kind, keys = CASES["left out"]
        assert verify(changed(fitted(kind, **keys), lie), dictionaries[kind]).failures


def test_another_dictionary_is_found(fitted, verify, dictionaries):
    found = verify(fitted("people"), dictionaries["other people"])
    assert "the digests differ" in found.failures[str(dictionaries["other people"])]
    assert found.data["false"] == found.done
    with pytest.raises(InputError, match="landmark"):
        verify(fitted("people"), dictionaries["cars"])


def test_other_landmarks_are_found(fitted, verify, dictionaries, landmarks, tmp_path):
    lines = landmarks["people"].read_text().splitlines()
    cells = lines[1].split(",")
    lines[1] = ",".join([*cells[:2], str(float(cells[2]) + 0.1), *cells[3:]])
    other = tmp_path / "views.csv"
    other.write_text("\n".join(lines) + "\n")
    found = verify(fitted("people"), dictionaries["people"], [other])
    assert set(found.failures) == {str(other), cells[0]}
    # The file of the fit is known by its digest, whatever its name.
    same = shutil.copy(landmarks["people"], tmp_path / "renamed.csv")
    assert (
        verify(fitted("people"), dictionaries["people"], [other, same]).failures == {}
    )


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
    with pytest.raises(InputError):
        verify(
            changed(fitted("people"), lie),
            dictionaries["people"],
            [landmarks["people"]],
        )


def test_no_images_are_a_failure(fitted, verify, dictionaries, tmp_path):
    from shapefit.io import read_results, result_writer

    with result_writer(tmp_path / "none.h5") as writer:
        writer.append(read_results(fitted("people"), proofs=True).take(slice(0)))
    found = verify(tmp_path / "none.h5", dictionaries["people"])
    assert "holds no image" in "".join(found.failures.values())
    assert found.note == "No image was checked."


@pytest.fixture(scope="session")
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


def edit(folder, change):
    path = folder / "manifest.jsonl"
    run, *parts = map(json.loads, path.read_text().splitlines())
    lines = [run, *change(parts)]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))


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
    edit(
        folder,
        lambda parts: [
            part | {"rows": [r + 1 for r in part["rows"]]} for part in parts
        ],
    )


def replace_by_a_pipe(folder):
    lose_file(folder)
    os.mkfifo(folder / "part-00001.h5")


LIES_OF_FOLDERS = [
    *(exchange, lose_file, add_file, no_parts, shift_rows, replace_by_a_pipe)
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
    assert verify(folder, dictionaries["cars"], [other]).failures == {}
    with h5py.File(other, "r+") as file:
        rows = [3, 100]
        names = file["item"].asstr()[rows].tolist()
        file["landmarks"][rows] += 1.0
    found = verify(folder, dictionaries["cars"], [other])
    assert set(names) <= set(found.failures)
    assert found.data["false"] == 2


def damage(part):
    data = bytearray(part.read_bytes())
    data[2000:12000] = bytes(10000)
    part.write_bytes(data)


@pytest.mark.parametrize("number", [0, 1])
def test_a_damaged_part_is_named_and_the_others_are_checked(
    folder, verify, dictionaries, number
):
    damage(folder / f"part-0000{number}.h5")
    found = verify(folder, dictionaries["cars"])
    assert found.done == [44, 64][number]
    assert "cannot be read" in found.failures[str(folder / f"part-0000{number}.h5")]
    assert f"Certified  {found.done} of 108 images" in found.note
    damage(folder / f"part-0000{1 - number}.h5")
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
