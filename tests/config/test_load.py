"""Files, options and arguments become one checked config."""

import io
import json
import math
import os
from pathlib import Path

import pytest
from hypothesis import strategies as st
from ruamel.yaml import YAML

from shapefit.config import CONFIGS, dump_config, load_config
from shapefit.config.loader import read_yaml
from shapefit.config.paths import DICTIONARIES, find_presets
from shapefit.config.reference import describe_keys
from shapefit.errors import InputError

PRINTABLE = st.text(st.characters(exclude_categories=["C", "Zl", "Zp"]), min_size=1)
FIT = "landmarks: a.h5\ndictionary: a.h5\noutput: r.h5\n"
EVAL = {"results": "a.h5", "truth": "a.h5", "output": "r"}
LEARN = {"shapes": "a.h5", "output": "d.h5"}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder with data files, and configs in a subfolder."""
    for name in ("a.h5", "b.h5", "c.csv", "configs/a.h5", "far/x.h5", "far/deep/y.h5"):
        (tmp_path / name).parent.mkdir(exist_ok=True, parents=True)
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(folder: Path, text: str, name: str = "configs/c.yaml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path.relative_to(folder)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("+1", 1),
        ("08", 8),
        ("0o17", 15),
        ("0x1F", 31),
        ("12", 12),
        ("007.50", 7.5),
        (".5", 0.5),
        ("-1.5e3", -1500.0),
        ("1e-3", 1e-3),
        ("-.inf", -math.inf),
        ("true", True),
        *((text, text) for text in ("1:30", "no", "e3", "2001-01-01", "a+b-", "nan")),
        ("&one [1]\n- [*one, *one]", [1]),
    ],
)
def test_numbers_and_words_are_those_of_the_core_schema(text, value):
    read = read_yaml(f"- {text}\n", "here")
    assert isinstance(read[0], type(value))
    assert read[0] == value
    assert "\n" in text or repr(read_yaml(text, "--set")) == repr(value)
    assert read[1:] in ([], [[[1], [1]]])


def test_arguments_go_over_options_and_options_over_the_file(folder):
    text = (
        FIT + "noise: 1\nthreads: 1\nlambda: 1\ncamera: {focal: 7, principal_point: [1,"
        " 2]}\n"
    )
    arguments = {"threads": 3, "lambda": None, "camera.focal": 9.0}
    options = ["noise=2", "threads=2", "prior={scale: 2}", "save.covariance=true"]
    config = load_config("fit", write(folder, text), options, arguments)
    assert config.threads == 3
    assert config.noise == 2
    assert config.lam == 1
    assert config.camera.focal == 9
    assert config.camera.principal_point == (1, 2)
    assert config.prior.scale == 2
    assert config.save.covariance


@pytest.mark.parametrize(
    ("command", "arguments", "name"),
    [
        ("fit", {"landmarks": ("c.csv", "a.h5")}, "c.h5"),
        ("fit", {"landmarks": "a.h5"}, "a_result.h5"),
        ("fit", {"landmarks": "far"}, "far.h5"),
        ("fit", {"landmarks": "far/x.h5"}, "x.h5"),
        ("learn-dict", {"shapes": "a.h5"}, "a_dictionary.h5"),
        ("project", {"shapes": "a.h5"}, "a_landmarks.h5"),
        ("eval", {"results": ("a.h5", "b.h5"), "truth": "b.h5"}, "a_report"),
    ],
)
def test_an_output_is_named_after_the_first_input(folder, command, arguments, name):
    assert load_config(command, arguments=arguments).output == folder / name


def test_paths_are_relative_to_who_says_them(folder):
    config = load_config(
        "fit", write(folder, FIT), ["output=o.h5"], {"landmarks": ("a.h5",)}
    )
    assert config.dictionary == folder / "configs" / "a.h5"
    assert config.output == folder / "o.h5"
    assert config.landmarks == (folder / "a.h5",)
    config = load_config("fit", None, ["landmarks=-", "output= - "])
    assert config.landmarks == (Path("-"),)
    assert config.output == Path("-")
    assert config.dictionary == DICTIONARIES / "people.h5"


@pytest.mark.parametrize(
    ("shapes", "names"),
    [
        ("[../b.h5, '../?.h5', '../far/**/*.h5']", "b.h5 a.h5 far/deep/y.h5 far/x.h5"),
        ("../x[1].h5", "x[1].h5"),
        ("'../[d]/*.h5'", "[d]/z.h5"),
        ("'{data}/../[d]/?.h5'", "[d]/z.h5"),
        ("../pipe.csv", "pipe.csv"),
        ("../*.csv", "c.csv"),
        ("['{data}/x.h5', '{data}/deep/*.h5']", "far/x.h5 far/deep/y.h5"),
    ],
)
def test_globs_are_sorted_and_name_each_file_once(folder, shapes, names):
    for name in ("x[1].h5", "x1.h5"):
        (folder / name).touch()
    (folder / "[d]").mkdir()
    (folder / "[d]/z.h5").touch()
    os.mkfifo(folder / "pipe.csv")  # a file, but not for a glob
    path = write(folder, f"shapes: {shapes}\noutput: d.h5\n")
    found = load_config("learn-dict", path, ["data=far"]).shapes
    assert found == tuple(folder / name for name in names.split())


def test_a_folder_of_results_stands_for_the_parts_that_are_done(folder):
    made_of = {"inputs": ["a.h5"], "rows": None, "states": [[1, 1]]}
    counts = {"images": 1, "failed": 0, "bytes": 1, "error": "damaged"}
    lines = [{"shapefit": "1", "method": "convex", "estimated": {}}]
    for number, status in ((100000, "done"), (9, "done"), (8, "failed")):
        name = {"file": f"part-{number:05}.h5", "status": status}
        lines.append(name | made_of | counts)
    text = "".join(f"{json.dumps(line)}\n" for line in lines)
    (folder / "far/manifest.jsonl").write_text(f"{text}cut off")
    config = load_config("convert", None, (), {"files": "far", "output": "o.h5"})
    names = ("part-00009.h5", "part-100000.h5")
    assert config.files == tuple(folder / "far" / name for name in names)


def test_results_have_the_names_of_their_files_or_of_a_mapping(folder):
    config = load_config(
        "eval", None, (), {"results": "?.h5", "truth": "a.h5", "output": "r"}
    )
    assert list(config.results) == ["a", "b"]
    text = (
        "results: {ours: ../a.h5, theirs: [../b.h5, ../c.csv]}\ntruth:"
        " ../a.h5\noutput: r\n"
    )
    config = load_config("eval", write(folder, text))
    assert [len(paths) for paths in config.results.values()] == [1, 2]


@pytest.mark.parametrize(
    ("command", "keys"),
    [
        ("eval", EVAL | {"groups": {"walks": "13_*"}}),
        (
            "learn-dict",
            LEARN | {"data": "far", "landmarks": ["no", "1e-3", "hip: left"]},
        ),
        ("learn-dict", LEARN | {"k": 3, "mirror": True}),
    ],
)
def test_a_printed_config_loads_again(folder, command, keys):
    config = CONFIGS[command](**keys)
    assert load_config(command, write(folder, dump_config(config))) == config
    for key in keys.keys() & {"bases", "k"}:
        assert getattr(config, key) == keys[key]


@pytest.mark.parametrize(
    ("command", "text"),
    [
        ("fit", "landmarks: ['*.h5']\ndictionary: b.h5\noutput: sub/../b.h5\n"),
        ("fit", "landmarks: a.h5\ndictionary: b.h5\noutput: link.h5\n"),
        ("project", "shapes: a.h5\noutput: a.h5\n"),
    ],
)
def test_an_output_cannot_replace_an_input(tmp_path, monkeypatch, command, text):
    monkeypatch.chdir(tmp_path)
    for name in ("a.h5", "b.h5"):
        (tmp_path / name).touch()
    (tmp_path / "sub").mkdir()
    (tmp_path / "link.h5").symlink_to("a.h5")
    (tmp_path / "c.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(
        InputError, match=r"c\.yaml:\d:1: `output` would replace an input, .*h5"
    ):
        load_config(command, Path("c.yaml"))
    load_config(command, Path("c.yaml"), arguments={"output": "new.h5"})


def test_a_config_can_come_from_standard_input(folder, monkeypatch):
    text = b"landmarks: a.h5\ndictionary: b.h5\noutput: r.h5\nlambda: 0.3\n"
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text)))
    config = load_config("fit", Path("-"))
    assert config.lam == 0.3
    assert config.output == folder / "r.h5"
    monkeypatch.setattr(
        "sys.stdin", io.TextIOWrapper(io.BytesIO(text + b"threads: -1\n"))
    )
    with pytest.raises(InputError, match="standard input:5:1: expected a whole number"):
        load_config("fit", Path("-"))


def test_keys_are_few():
    listed = {
        command: [row.name for row in describe_keys(model)]
        for command, model in CONFIGS.items()
    }
    assert sum(map(len, listed.values())) <= 110
    assert len(listed["fit"]) <= 39


def leaves(values, way=""):
    """Yield the ways of the keys of a config as it is printed."""
    for name, value in values.items():
        if isinstance(value, dict) and value:
            yield from leaves(value, f"{way}{name}.")
        else:
            yield way + name


@pytest.mark.parametrize("command", CONFIGS)
def test_every_key_that_is_printed_is_listed(command):
    fields = CONFIGS[command].model_fields
    absent = {
        key: None
        for key, field in fields.items()
        if field.is_required() or key == "output"
    }
    config = load_config(command, None, (), {}, placeholders=absent)
    printed = YAML(typ="safe").load(dump_config(config))
    listed = {row.name for row in describe_keys(CONFIGS[command])}
    assert {*leaves(printed)} - {"data"} <= listed


MINE = {"landmarks": ("a.h5",), "dictionary": "b.h5", "output": "r.h5"}


def test_the_settings_of_a_preset_count_without_its_data(folder):
    config = load_config("fit", Path("cars"), (), MINE)
    assert config.method == "convex+refine"
    assert config.lam == 1.0
    assert config.camera.focal == "files"
    assert config.landmarks == (folder / "a.h5",)
    assert config.data is config.leave_one_out is config.camera.principal_point is None
    report = load_config("eval", Path("cars"), (), EVAL)
    assert report.match == "item"
    assert report.groups == {}
    assert report.least_visible == 20


def test_a_file_wins_over_an_installed_one_and_a_folder_does_not(folder):
    for name in ("cars", "people"):
        (folder / name).mkdir()
    config = load_config("fit", Path("cars"), (), MINE | {"dictionary": "people"})
    assert config.lam == 1
    assert config.dictionary == DICTIONARIES / "people.h5"
    for name in ("cars", "people"):
        (folder / name).rmdir()
        (folder / name).write_text("lambda: 7\n")
    config = load_config("fit", Path("cars"), (), MINE | {"dictionary": "people"})
    assert config.lam == 7
    assert config.dictionary == folder / "people"


def test_a_config_names_a_dictionary_unless_a_file_beside_the_config_does(folder):
    path = write(folder, "landmarks: a.h5\ndictionary: people\noutput: r.h5\n")
    (folder / "people").touch()
    assert load_config("fit", path).dictionary == DICTIONARIES / "people.h5"
    (folder / "configs/people").touch()
    assert load_config("fit", path).dictionary == folder / "configs/people"


@pytest.mark.parametrize("command", ["learn-dict", "fit", "eval", "project"])
def test_every_preset_is_right_but_for_files(folder, command):
    given = {"learn-dict": LEARN, "fit": MINE, "eval": EVAL, "project": LEARN}[command]
    presets = find_presets(command)
    for name in presets:
        load_config(command, Path(name), (), given | {"output": "out"})
    assert "demo" in presets


def test_stand_ins_take_the_place_of_files(folder):
    text = "landmarks: nowhere.h5\ndictionary: nowhere.h5\nlambda: 2\n"
    files = {"landmarks": ("x",), "dictionary": "y", "output": "z"}
    config = load_config("fit", write(folder, text), placeholders=files)
    assert config.landmarks == ("x",)
    assert config.dictionary == "y"
    assert config.output == "z"
    shown = load_config(
        "fit", None, ["lambda=2"], placeholders={"landmarks": None, "output": None}
    )
    assert shown.landmarks is None
    assert shown.output is None
    assert shown.lam == 2
    again = load_config(
        "fit", write(folder, dump_config(shown)), (), {"landmarks": "a.h5"}
    )
    assert again == load_config("fit", None, ["lambda=2"], {"landmarks": "a.h5"})
