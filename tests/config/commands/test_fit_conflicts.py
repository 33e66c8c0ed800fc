"""Keys of `fit` that do not go together: told at the place of the first that a message names."""

from __future__ import annotations

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


@pytest.mark.parametrize(
    ("addition", "place", "expected"),
    [
        ("loss: l1\noutliers: {method: ransac}", "4:7", "`loss: l1` and `outliers"),
        ("loss: sparse-error\noutliers: {method: truncated}", "4:7", "`loss: sparse-error` and"),
        (
            "loss: exact\nmethod: convex+refine",
            "4:7",
            "the method convex+refine does not support `loss: exact`",
        ),
        ("method: alternate\nloss: l1", "5:7", "the method alternate does not support `loss: l1`"),
        ("loss: l1\nsolver: {name: admm}", "4:7", "the solver admm supports only `loss: squared`"),
        ("outliers: {threshold: 0}", "4:23", "expected a number > 0"),
        ("lambda: auto", "4:9", "`lambda: auto` needs `noise`"),
        ("path: [1, 2]", "4:7", "expected falling numbers, found [1.0, 2.0]"),
        ("path: [2, 1, 1]", "4:7", "expected falling numbers, found [2.0, 1.0, 1.0]"),
        ("method: alternate\npath: [2, 1]", "5:7", "`path` belongs to the method convex"),
        ("leave_out: item\npath: [2, 1]", "5:7", "`path` works neither with `leave_out`"),
        ("outliers: {method: ransac}\npath: [2, 1]", "5:7", "`path` works neither"),
        (
            "temporal: {depths: true}\ncamera: {model: perspective, focal: 2}",
            "4:11",
            "`temporal: {depths: true}` refines shapes under weak perspective",
        ),
        (
            "method: pmp\ncamera: {model: perspective, focal: 2}",
            "5:9",
            "`camera: {model: perspective}` does not work with the method pmp",
        ),
        (
            "camera: {ridge: 1, model: weak-perspective}",
            "4:17",
            "`ridge` belongs to `model: perspective`",
        ),
        ("camera: {principal_point: [1, 2]}", "4:27", "`principal_point` belongs to"),
        ("export: {format: obj}", "4:18", "`format` does nothing without `folder`"),
        ("export: {items: [a, b]}", "4:17", "`items` does nothing without `folder`"),
        ("pictures: {sheet: 4, folder: null}", "4:19", "`sheet` does nothing without `folder`"),
        ("camera: {model: perspective}", "4:17", "`model: perspective` and a focal length"),
        ("camera: {focal: 2}", "4:17", "`model: perspective` and a focal length"),
        (
            "camera: {model: perspective, intrinsics: K, focal: 2}",
            "4:52",
            "`focal` and `intrinsics` exclude each other",
        ),
        (
            "method: alternate\nexport: {folder: out, rotation: per-atom}",
            "5:9",
            "`export: {rotation: per-atom}` belongs to the method convex",
        ),
    ],
)
def test_settings_that_do_not_go_together(addition, place, expected):
    assert problem(addition).startswith(f"c.yaml:{place}: {expected}")


def test_keys_that_do_not_go_together_and_are_said_by_options():
    told = problem("loss: l1", "outliers.method=ransac")
    assert told.startswith("c.yaml:4:7: `loss: l1` and")
    told = problem("", "lambda=auto")
    assert told.startswith("--set lambda=auto: `lambda: auto` needs `noise`")


def test_defaults_are_no_conflict():
    text = (
        "landmarks: a.h5\ndictionary: a.h5\noutput: r.h5\n"
        "export: {format: ply}\ncamera: {ridge: 0.3}\npictures: {folder: p, sheet: 4}\n"
    )
    Path("c.yaml").write_text(text, encoding="utf-8")
    first = load_config("fit", Path("c.yaml"))
    Path("c.yaml").write_text(dump_config(first), encoding="utf-8")
    assert load_config("fit", Path("c.yaml")) == first
