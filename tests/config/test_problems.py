"""Every problem of a config is told at once, at its place, with what to do."""

import re
import socket
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
    text = "landmark: a.h5\ndictionary: a.h5\nlambda: -1\nlambda: 2\nsolver: {tolerance: no}\n"
    told = problems("fit", text, "chunk=0", "thread=1")
    assert sorted(line.split(": ")[0] for line in told) == [
        "--set chunk=0",
        "--set thread=1",
        "c.yaml:1:1",  # unknown landmark
        "c.yaml:1:1",  # missing landmarks
        "c.yaml:1:1",  # missing output
        "c.yaml:3:9",
        "c.yaml:4:1",
        "c.yaml:5:21",
    ]


WORDS = {
    "auto": "expected a number > 0 or auto",
    "chunk": "expected a whole number >= 1 and <= 10000000",
    "every": "expected a whole number >= 1, or a mapping of globs on sequence names to such "
    "numbers",
    "bases": "expected a whole number >= 1, or a share > 0 and < 1",
    "align": "expected `all`, `none`, or a list of at least three different landmark names",
    "view": "expected turntable, random, or a rotation as three rows of three numbers",
    "solver": "the keys here are tolerance, max_iterations",
}

WRONG = """
fit | lambda: -0.1 | 4:9 | {auto}, found -0.1
fit | lambda: .nan | 4:9 | {auto}, found nan
fit | lambda: .inf | 4:9 | {auto}, found inf
fit | lambda: true | 4:9 | {auto}, found true
fit | lambda: | 4:1 | {auto}, found nothing
fit | lambda: 1_0 | 4:9 | {auto}, found '1_0'
fit | lambda: 0b1 | 4:9 | {auto}, found '0b1'
fit | lambda: +0x1 | 4:9 | {auto}, found '+0x1'
fit | lambda: [1] | 4:9 | {auto}, found a list
fit | chunk: 1_0 | 4:8 | {chunk}, found '1_0'
fit | chunk: 2.5 | 4:8 | {chunk}, found 2.5
fit | strict: no | 4:9 | expected true or false, found 'no'
fit | threads: -1 | 4:10 | expected a whole number >= 0 and <= 1024, found -1
fit | lam: 1 | 4:1 | unknown key 'lam'; did you mean 'lambda'?
fit | tolerance: 1 | 4:1 | unknown key 'tolerance'; did you mean 'solver.tolerance'?
fit | solver: {zzz: 1} | 4:10 | unknown key 'zzz'; {solver}
fit | solver: newton | 4:9 | expected a mapping with the keys tolerance, max_iterations, found 'newton'
fit | solver: {tolerance: 0} | 4:21 | expected a number > 0, found 0
fit | loss: squarred | 4:7 | expected squared or exact, found 'squarred'; did you mean 'squared'?
fit | alternation: {views: 0} | 4:22 | expected a whole number from 1 to 1000 or all, found 0
eval | metrics: [camra] | 4:11 | expected similarity or camera or rotation or reprojection or precision or recall, found 'camra'; did you mean 'camera'?
eval | metrics: [] | 4:10 | expected at least one metric, found an empty list
eval | least_visible: -1 | 4:16 | expected
eval | groups: {A: 3} | 4:13 | expected a mapping to strings, found 3
learn-dict | k: 0 | 3:4 | expected a whole number >= 1, found 0
learn-dict | k: 1e3 | 3:4 | expected a whole number >= 1, found 1000.0
learn-dict | every: 0 | 3:8 | {every}, found
learn-dict | every: true | 3:8 | {every}, found
learn-dict | every: 1.5 | 3:8 | {every}, found
learn-dict | every: {} | 3:8 | {every}, found
learn-dict | every: {a_*: 0} | 3:8 | {every}, found
learn-dict | every: {a_*: two} | 3:8 | {every}, found
learn-dict | every: [1, 2] | 3:8 | {every}, found
learn-dict | beta: -1 | 3:7 | expected a number >= 0, found -1
learn-dict | method: pca-bases; k: 32 | 4:1 | `k` has no effect here, only with `method: sparse-coding`; leave it out
learn-dict | method: exemplars; beta: 1 | 4:1 | `beta` has no effect here, only with `method: sparse-coding`; leave it out
learn-dict | bases: 3 | 3:1 | `bases` has no effect here, only with `method: pca-bases`; leave it out
learn-dict | method: pca-bases; bases: 0 | 4:8 | {bases}, found 0
learn-dict | method: pca-bases; bases: 1.1 | 4:8 | {bases}, found 1.1
learn-dict | method: pca-bases; bases: 1.0 | 4:8 | {bases}, found 1.0
learn-dict | method: pca-bases; bases: true | 4:8 | {bases}, found true
learn-dict | method: pca-base | 3:9 | expected sparse-coding or exemplars or pca-bases, found 'pca-base'; did you mean 'pca-bases'?
learn-dict | seed: 1 | 3:1 | unknown key 'seed'
learn-dict | align: [a, b] | 3:8 | {align}, found ['a', 'b']
learn-dict | align: [a, b, a] | 3:8 | {align}, found ['a', 'b', 'a']
learn-dict | align: al | 3:8 | {align}, found 'al'
project | hidden: 1 | 3:9 | expected a number >= 0 and < 1, found 1
project | noise: -1 | 3:8 | expected a number >= 0, found -1
project | camera: {view: [[1,0,0],[0,1,0],[0,0,-1]]} | 3:16 | expected a rotation (orthonormal rows, determinant +1)
project | camera: {view: turn} | 3:16 | {view}, found
project | camera: {view: [[1,0,0],[0,1,0]]} | 3:16 | {view}, found
project | camera: {view: [1, 0, 0]} | 3:16 | {view}, found
project | camera: {view: [[1,0,0],[0,1,0],[0,0,one]]} | 3:16 | {view}, found
"""  # noqa: E501
"""Command, what its config says besides, the place of the fault, and a part of the message."""


@pytest.mark.parametrize("case", WRONG.strip().splitlines())
def test_one_wrong_value(case):
    command, addition, place, message = case.split(" | ")
    told = only_problem(command, addition.replace("; ", "\n") + "\n")
    assert told.startswith(f"c.yaml:{place}: ")
    assert message.format(**WORDS) in told


def test_a_proper_rotation_is_accepted():
    Path("c.yaml").write_text(PROJECT + "camera: {view: [[0,1,0],[-1,0,0],[0,0,1.0]]}\n")
    assert load_config("project", Path("c.yaml")).camera.view == (
        (0, 1, 0),
        (-1, 0, 0),
        (0, 0, 1),
    )


@pytest.mark.parametrize(
    ("option", "expected"),
    [
        (
            'pictures.folder="\\0"',
            '--set pictures.folder="\\0": expected a path, found one with a zero byte',
        ),
        ("lambda=-1", "--set lambda=-1: expected a number > 0 or auto, found -1"),
        ("lambda=", "--set lambda=: expected a number > 0 or auto, found nothing"),
        ("solver.tol=1", "--set solver.tol=1: unknown key 'tol'; the keys here are tolerance, max"),
        ("outliers.method=l2", "--set outliers.method=l2: expected none or ransac or sparse-error"),
        ("lambda", "--set lambda: expected key=value or key.key=value"),
        ("=1", "--set =1: expected key=value or key.key=value"),
        ("lambda.x=1", "--set lambda.x=1: expected a number > 0 or auto, found a mapping"),
        ("method=*x", "--set method=*x: not valid YAML"),
        ("solver={tolerance: 1, tolerance: 2}", "repeated key 'tolerance'"),
        ("dictionary.x=1", "--set dictionary.x=1: dictionary is 'a.h5' and has no keys"),
    ],
)
def test_a_wrong_option_is_named_by_its_text(option, expected):
    told = only_problem("fit", "", option)
    assert expected.replace("'a.h5'", repr(str(Path.cwd() / "a.h5"))) in told


@pytest.mark.parametrize("value", ['"\\ud800"', "[a", "*x"])
def test_a_key_whose_value_cannot_be_read_is_not_missing(value):
    text = "dictionary: a.h5\noutput: out.h5\n"
    (told,) = problems("fit", text, f"landmarks={value}")
    assert told.startswith(f"--set landmarks={value}: ")


def test_an_option_over_a_mapping_is_blamed_for_what_is_in_it():
    option = "outliers={method: l2}"
    told = only_problem("fit", "outliers: {method: l1}\n", option)
    assert told.startswith(f"--set {option}: expected none or ransac")


def test_a_wrong_argument_is_named():
    (told,) = problems("fit", FIT, dictionary="nowhere.h5")
    assert told == f"command line, dictionary: no file {Path.cwd()}/nowhere.h5; check the spelling"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a: b: c\n", "c.yaml:1:5: not valid YAML: "),
        ("lambda: [1, 2\n", "c.yaml:2:1: not valid YAML: "),
        ("\tlambda: 1\n", "c.yaml:1:1: not valid YAML: "),
        ("- a\n- b\n", "c.yaml:1:1: expected keys with values (key: value), found a list"),
        ("--- {}\n--- {}\n", "c.yaml:2:1: not valid YAML: "),
        ("? [a]\n: 1\n", "c.yaml:1:3: a key must be a string"),
        ("lambda: !!int x\n", "c.yaml:1:9: 'x' does not match its tag"),
        ("lambda: !!bool x\n", "c.yaml:1:9: 'x' does not match its tag"),
        ("lambda: !!float ''\n", "c.yaml:1:9: '' does not match its tag"),
        ("a: \x00\n", "c.yaml:1:1: not valid YAML: "),
        (
            "lambda: 1\ngroups: &x [*x]\n",
            "c.yaml:2:9: an alias contains itself; write it out",
        ),
        ("&x {fit: {lambda: *x}}\n", "c.yaml:1:1: an alias contains itself"),
        ("[" * 3000 + "]" * 3000, "c.yaml:1:1: lists or mappings are nested too deeply"),
    ],
)
def test_broken_yaml_has_a_place(text, expected):
    assert any(line.startswith(expected) for line in problems("fit", text)), problems("fit", text)


def test_an_empty_file_misses_the_required_keys():
    told = problems("fit", "")
    assert [re.sub(r" \(.*", "", line) for line in told] == [
        "c.yaml:1:1: missing key 'landmarks'",
        "c.yaml:1:1: missing key 'dictionary'",
        "c.yaml:1:1: missing key 'output'",
    ]


def test_a_config_that_cannot_be_read_is_named(folder):
    with pytest.raises(InputError, match=r"nowhere\.yaml: No such file"):
        load_config("fit", Path("nowhere.yaml"))
    with pytest.raises(InputError, match="sub: Is a directory"):
        load_config("fit", Path("sub"))
    (folder / "latin.yaml").write_bytes(b"output: \xe9\n")
    with pytest.raises(InputError, match=r"latin\.yaml: not UTF-8 text"):
        load_config("fit", Path("latin.yaml"))


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("x.h5", "c.yaml:1:12: no file {folder}/x.h5; check the spelling"),
        ("'*.csv'", "c.yaml:1:12: no file matches {folder}/*.csv; check the pattern"),
        ("x" * 300, "/" + "x" * 300 + " cannot be read: File name too long; check the path"),
        ("loop", "c.yaml:1:12: {folder}/loop cannot be read: Too many levels of symbolic links;"),
        ("socket", "c.yaml:1:12: {folder}/socket is neither a file nor a pipe; name one, or use -"),
        ('"a\\0b"', "expected a path, found one with a zero byte"),
        ("'*/" + "x" * 300 + "'", "; check the pattern"),
        ("3", "c.yaml:1:12: expected a path, found 3"),
        ("''", "c.yaml:1:12: "),
        ("[]", "c.yaml:1:12: expected at least one path, found an empty list"),
        ("[a.h5, x.h5]", "c.yaml:1:19: no file {folder}/x.h5"),
        ("'{data}/a.h5'", "set it in the config or with --set data=FOLDER"),
        ("'sub/{data}/a.h5'", "it is allowed at the beginning only"),
    ],
)
def test_a_path_that_names_no_file(folder, path, expected):
    (folder / "loop").symlink_to("loop")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind("socket")  # relative: the path of a socket must be short
    (told,) = problems("fit", FIT.replace("a.h5", path, 1))
    assert expected.format(folder=folder, data="{data}") in told


def test_one_dictionary_only(folder):
    (folder / "b.h5").touch()
    (told,) = problems("fit", FIT.replace("dictionary: a.h5", "dictionary: '*.h5'"))
    assert "matches 2 files; name one" in told


def test_results_of_one_name_must_be_named_apart(folder):
    (told,) = problems("eval", EVAL.replace("results: a.h5", "results: [a.h5, sub/a.csv]"))
    assert "would both be called 'a'" in told
