"""Keys of `fit` that do not go together: told at the place of the first that a message names."""

from pathlib import Path

import pytest

from shapefit.config import dump_config, load_config
from shapefit.errors import InputError


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    (tmp_path / "a.h5").touch()
    monkeypatch.chdir(tmp_path)


def problem(addition: str, *options: str) -> str:
    text = f"landmarks: a.h5\ndictionary: a.h5\noutput: r.h5\n{addition}\n"
    Path("c.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_config("fit", Path("c.yaml"), options)
    (told,) = caught.value.problems
    return told


CONFLICTS = """
loss: exact; outliers: {method: l1} | 4:7 | `loss: exact` and `outliers
loss: exact; method: convex+refine | 4:7 | the method convex+refine does not support `loss: exact`
method: alternate; outliers: {method: l1} | 5:11 | the method alternate does not support `outliers: {method: l1}`; use another, or `method: convex`
outliers: {threshold: 0} | 4:23 | expected a number > 0
lambda: auto | 4:9 | `lambda: auto` needs `noise`
method: pmp; camera: {model: perspective, focal: 2} | 5:9 | `camera: {model: perspective}` does not work with the method pmp
method: posterior; leave_out: true_model | 5:12 | `leave_out` leaves out atoms, but the prior of the method posterior was
camera: {principal_point: [1, 2]} | 4:27 | `principal_point` belongs to
export: {format: obj} | 4:18 | `format` does nothing without `folder`
export: {items: [a, b]} | 4:17 | `items` does nothing without `folder`
pictures: {sheet: 4, folder: null} | 4:19 | `sheet` does nothing without `folder`
camera: {model: perspective} | 4:17 | `model: perspective` and a focal length
camera: {focal: 2} | 4:17 | `model: perspective` and a focal length
camera: {model: perspective, intrinsics: K, focal: 2} | 4:52 | `focal` and `intrinsics` exclude each other
method: alternate; rotations: per-atom | 5:12 | `rotations: per-atom` belongs to the method convex and weak perspective
rotations: orthogonal; camera: {model: perspective, focal: 2} | 4:12 | `rotations: orthogonal` belongs to the method convex and weak perspective
"""  # noqa: E501
"""What the config says besides, the place of the fault, and the beginning of the message."""


@pytest.mark.parametrize("case", CONFLICTS.strip().splitlines())
def test_settings_that_do_not_go_together(case):
    addition, place, expected = case.split(" | ")
    assert problem(addition.replace("; ", "\n")).startswith(f"c.yaml:{place}: {expected}")


def test_keys_that_do_not_go_together_and_are_said_by_options():
    told = problem("loss: exact", "outliers.method=l1")
    assert told.startswith("c.yaml:4:7: `loss: exact` and")
    told = problem("", "lambda=auto")
    assert told.startswith("--set lambda=auto: `lambda: auto` needs `noise`")


def test_defaults_are_no_conflict():
    text = (
        "landmarks: a.h5\ndictionary: a.h5\noutput: r.h5\n"
        "export: {format: ply}\npictures: {folder: p, sheet: 4}\n"
    )
    Path("c.yaml").write_text(text, encoding="utf-8")
    first = load_config("fit", Path("c.yaml"))
    Path("c.yaml").write_text(dump_config(first), encoding="utf-8")
    assert load_config("fit", Path("c.yaml")) == first
