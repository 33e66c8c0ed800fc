"""Every problem of a config is told at once, at its place, with what to do."""

from itertools import pairwise
from pathlib import Path

import pytest

from shapefit.config import load_config
from shapefit.errors import InputError

FIT = "landmarks: a.h5\ndictionary: a.h5\noutput: r.h5\n"
PROJECT = "shapes: a.h5\noutput: v.h5\n"
LEARN = "shapes: a.h5\noutput: d.h5\n"
EVAL = "results: a.h5\ntruth: a.h5\noutput: report\n"
BASES = {"fit": FIT, "project": PROJECT, "learn-dict": LEARN, "eval": EVAL}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    (tmp_path / "a.h5").touch()
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub/a.csv").touch()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def problems(command: str, text: str, *options: str, **arguments) -> tuple[str, ...]:
    Path("c.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_config(command, Path("c.yaml"), options, arguments)
    return caught.value.problems


def only_problem(command: str, addition: str, *options: str) -> str:
    (problem,) = problems(command, BASES[command] + addition, *options)
    return problem


def test_every_problem_is_told_at_once():
    text = "landmark: a.h5\ndictionary: a.h5\nlambda: -1\nprior: {scale: no}\n"
    told = problems("fit", text, "noise=-1", "thread=1")
    assert sorted(line.split(": ")[0] for line in told) == [
        "--set noise=-1",
        "--set thread=1",
        "c.yaml:1:1",  # unknown landmark
        "c.yaml:1:1",  # missing landmarks
        "c.yaml:3:1",
        "c.yaml:4:9",
    ]


WRONG = """
fit | lambda: -0.1 | 4:1 | expected a number > 0 or auto, found -0.1
fit | lambda: .nan | 4:1 | expected a number > 0 or auto, found nan
fit | lambda: | 4:1 | expected a number > 0 or auto, found nothing
fit | threads: 3000000000 | 4:1 | expected a whole number >= 0 and <= 1024, found 3000000000
fit | save: {covariance: no} | 4:8 | expected true or false, found 'no'
fit | scale: 1 | 4:1 | unknown key 'scale'; did you mean 'prior.scale'?
fit | prior: {zzz: 1} | 4:9 | unknown key 'prior.zzz'; the keys here are scale, residual_variance, calibration
fit | prior: wide | 4:1 | expected a mapping with the keys scale, residual_variance, calibration, bar_scale, found 'wide'
fit | skeleton: {head: 2, neck: 1} | 4:21 | expected a mapping of head, hips and shoulders to factors > 0, or auto, found
fit | image_size: [1, -2] | 4:17 | expected a list of 2 items, each a number > 0, found -2
fit | noise: 1; noise: 2 | 5:1 | not valid YAML: found duplicate key 'noise'
fit | noise: !!int x | 4:8 | not valid YAML: 'x' is no int
fit | noise: !!bool x | 4:8 | not valid YAML: 'x' is no bool
fit | noise: |;   ;    x | 6:4 | not valid YAML: more indented follow up line than first in a block scalar
fit | lam: 1 | 4:1 | unknown key 'lam'; did you mean 'lambda'?
eval | metrics: [camra] | 4:11 | expected a list, each similarity, camera, rotation, reprojection, expected, precision or recall, found 'camra'; did you mean 'camera'?
eval | groups: {A: 3} | 4:10 | expected a mapping to values, each a text, found 3
learn-dict | k: 1e3 | 3:1 | expected a whole number >= 1, found 1000.0
learn-dict | every: {a_*: two} | 3:1 | or a mapping to values, each a whole number >= 1, found a mapping
learn-dict | method: pca-base | 3:1 | expected sparse-coding, exemplars or pca-bases, found 'pca-base'; did you mean 'pca-bases'?
learn-dict | seed: 1 | 3:1 | unknown key 'seed'
learn-dict | align: [a, b] | 3:1 | expected all or none, found a list
project | hidden: 1 | 3:1 | expected a number >= 0 and < 1, found 1
project | camera: {view: [[2,0,0],[0,1,0],[0,0,1]]} | 3:10 | expected a rotation (orthonormal rows, determinant +1)
project | camera: {view: [[1,0,0],[0,1,0]]} | 3:10 | expected turntable, random, or a rotation as three rows of three numbers, found
fit | method: alternate; outliers: l1 | 5:1 | the method alternate does not support `outliers: l1`; use `method: convex`
fit | method: pmp; camera: {focal: 2} | 5:10 | the method pmp has no perspective camera; leave out `camera.focal`
fit | method: posterior; leave_one_out: model | 5:1 | the method posterior has a prior that was learned from all shapes; `leave_one_out`
fit | method: convex; prior: {scale: 2} | 5:9 | the method convex has no prior; `prior.scale` needs one; use `method: posterior` or `method: sequences`
fit | starts: 0; method: alternate | 4:1 | expected a whole number >= 1 and <= 1000, found 0
fit | starts: -3; method: mean-shape | 4:1 | expected a whole number >= 1 and <= 1000, found -3
fit | starts: 1001; method: alternate | 4:1 | expected a whole number >= 1 and <= 1000, found 1001
fit | starts: 1.5; method: alternate | 4:1 | expected a whole number >= 1 and <= 1000, found 1.5
fit | method: convex; starts: 1 | 5:1 | the method convex does not support `starts`; use `method: alternate` or `method: mean-shape`, or leave it out
fit | method: convex+refine; starts: 6 | 5:1 | the method convex+refine does not support `starts`; use
fit | starts: 2; method: pmp | 4:1 | the method pmp does not support `starts`; use
fit | method: sequences; starts: 2 | 5:1 | the method sequences does not support `starts`; use
fit | camera: {principal_point: [1, 2]} | 4:10 | `principal_point` needs a focal length
fit | camera: {focal: 2, calibration: a.h5} | 4:10 | `focal` and `calibration` both give the focal length
fit | lambda: auto | 4:1 | `lambda: auto` needs `noise`
"""  # noqa: E501
"""Command, what its config says besides, the place of the fault, and a part of the
message.
"""


@pytest.mark.parametrize("case", WRONG.strip().splitlines())
def test_one_wrong_value(case):
    command, addition, place, message = case.split(" | ")
    told = only_problem(command, addition.replace("; ", "\n") + "\n")
    assert told.startswith(f"c.yaml:{place}: ")
    assert message in told


def test_an_option_over_a_mapping_is_blamed_for_what_is_in_it():
    option = "prior={scale: -1}"
    told = only_problem("fit", "prior: {scale: 2}\n", option)
    assert told.startswith(f"--set {option}: expected a number > 0 or auto, found -1")


BILLION = "a: &a [1,2,3,4,5,6,7,8,9]\n" + "".join(
    f"{new}: &{new} [{','.join([f'*{old}'] * 9)}]\n" for old, new in pairwise("abcdefg")
)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a: b: c\n", "c.yaml:1:5: not valid YAML: "),
        ("lambda: [1, 2\n", "c.yaml:2:1: not valid YAML: "),
        ("\tlambda: 1\n", "c.yaml:1:1: not valid YAML: "),
        (
            "- a\n- b\n",
            "c.yaml:1:1: expected keys with values (key: value), found a list",
        ),
        ("--- {}\n--- {}\n", "c.yaml:2:1: not valid YAML: "),
        ("a: \x00\n", "c.yaml:1:1: not valid YAML: unacceptable character"),
        (
            "&x {fit: {lambda: *x}}\n",
            "c.yaml:1:1: not valid YAML: lists or mappings are nested",
        ),
        (
            BILLION,
            "c.yaml:1:1: not valid YAML: more than 100000 values, aliases written out",
        ),
        ('a: "\\ud800"\n', "c.yaml:1:1: not valid YAML: half a letter"),
        (
            "[" * 1100 + "]" * 1100,
            "c.yaml:1:1: not valid YAML: lists or mappings are nested",
        ),
    ],
)
def test_broken_yaml_has_a_place(text, expected):
    assert any(line.startswith(expected) for line in problems("fit", text)), problems(
        "fit", text
    )


def test_a_config_that_cannot_be_read_is_named(folder):
    with pytest.raises(
        InputError, match=r"sub: is a directory; give one of: a YAML file, cars"
    ):
        load_config("fit", Path("sub"))
    (folder / "latin.yaml").write_bytes(b"output: \xe9\n")
    with pytest.raises(InputError, match=r"latin\.yaml: not UTF-8 text"):
        load_config("fit", Path("latin.yaml"))


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("x.h5", "c.yaml:1:1: no file {folder}/x.h5; check the spelling"),
        ("'*.csv'", "c.yaml:1:1: no file matches {folder}/*.csv; check the pattern"),
        ("x" * 300, "no file {folder}/" + "x" * 300 + "; check the spelling"),
        ('"a\\0b"', "expected a path, found 'a\\x00b'"),
        ("3", "c.yaml:1:1: expected a path, found 3"),
        ("[]", "c.yaml:1:1: expected a path or glob, or a list of them, found a list"),
        ("[a.h5, x.h5]", "c.yaml:1:19: no file {folder}/x.h5"),
        ("'{data}/a.h5'", "begins with the folder `data`; give --set data=FOLDER"),
    ],
)
def test_a_path_that_names_no_file(folder, path, expected):
    (told,) = problems("fit", FIT.replace("a.h5", path, 1))
    assert expected.format(folder=folder, data="{data}") in told


def test_results_of_one_name_must_be_named_apart(folder):
    (told,) = problems(
        "eval", EVAL.replace("results: a.h5", "results: [a.h5, sub/a.csv]")
    )
    assert "would both be called 'a'" in told


def test_one_file_is_not_several(folder):
    (folder / "b.h5").touch()
    told = only_problem("fit", "", "dictionary='*.h5'")
    assert "*.h5 is not one file; name one" in told
