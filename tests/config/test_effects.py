"""A key that has no effect is an error: every key of every command, by its schema."""

import re
from pathlib import Path

import pytest

from shapefit.config import CONFIGS, load_config
from shapefit.config.model import dotted_keys
from shapefit.config.settings import GONE
from shapefit.errors import InputError
from shapefit.pipelines.learn_dict.run import run as learn_dict

GIVEN = {
    "fit": {"landmarks": ("a.csv",), "dictionary": "people", "output": "r.h5"},
    "learn-dict": {"shapes": ("a.csv",), "output": "d.h5"},
    "eval": {"results": ("a.csv",), "truth": ("a.csv",), "output": "report"},
    "project": {"shapes": ("a.csv",), "output": "v.h5"},
    "convert": {"files": ("a.csv",), "output": "b.h5"},
    "info": {"files": ("a.csv",)},
    "view": {"files": ("a.csv",)},
}

ALWAYS = {
    "fit": "landmarks dictionary output height scheduler scheduler_file workers dry_run method "
    "loss rotations leave_out outliers.method camera.model camera.focal camera.intrinsics "
    "camera.principal_point camera.calibration camera.name "
    "export.folder export.format "
    "threads chunk strict transforms sequences.frame_rate",
    "learn-dict": "shapes output frame_rate start origin suits",
    "eval": "results truth output match groups metrics least_visible truth_frame plots view",
    "project": "shapes output camera.view camera.scale y_axis noise hidden",
    "convert": "files output dictionary to every every frame_rate height unit up",
    "info": "files",
    "view": "files truth dictionary images items frame_rate output",
}
"""Keys that always count, or whose values and conflicts are errors of their own."""

IDLE = {
    "fit": {
        "alternation.views=3": "",
        "alternation.signed=true": "method=mean-shape",
        "search.max_cells=9": "method=sequences",
        "search.max_seconds=9": "",
        "posterior.residual_variance=0.1": "method=convex",
        "posterior.least_score=0.5": "",
        "posterior.outlier_rate=0.5": "",
        "posterior.widening=2": "",
        "posterior.calibration=a.csv": "",
        "posterior.covariance=true": "method=posterior output=r.csv",
        "posterior.implausible=0.5": "",
        "posterior.prior_scale=2": "",
        "sequences.lengths=a.csv": "method=posterior",
        "solver.tolerance=0.01": "method=alternate",
        "solver.max_iterations=9": "method=pmp",
        "lambda=0.5": "loss=exact",
        "noise=0.5": "",
        "outliers.threshold=0.5": "",
        "theta={head: 1.5}": "",
        "partition=9": "",
        "proof=false": "output=r.csv",
    },
    "learn-dict": {
        "method=exemplars": "start=people",
        "every=3": "start=people",
        "align=none": "start=people",
        "symmetry=double": "start=people",
        "mirror={a: b}": "",
        "flip=true": "start=people",
        "k=9": "method=exemplars",
        "beta=0.5": "method=pca-bases",
        "iterations=3": "method=exemplars",
        "bases=3": "",
        **{
            f"prior.{key}": "start=people"
            for key in (
                "components=2", "shrinkage=0.5", "floor=0.1", "width=2",
                "stretch=0.5", "exchange=0.5", "weights=a",
            )
        },
    },
    "project": {"camera.up=z": "camera.view=random", "seed=3": ""},
    "view": {"match=model": ""},
}  # fmt: skip
"""Settings that have no effect -> what else is set, without which they might."""

OF_ALL = ("data", "storage_options")
"""Keys of every command, which paths refer to."""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("a.csv").touch()


def load(command, settings, file=None):
    paths = {word.partition("=")[0] for word in settings}
    given = {key: value for key, value in GIVEN[command].items() if key not in paths}
    return load_config(command, file, settings, given)


def problems(command, settings, file=None):
    with pytest.raises(InputError) as caught:
        load(command, settings, file)
    return caught.value.problems


def test_every_key_either_counts_always_or_is_refused_where_it_does_not():
    for command in GIVEN:
        keys = {key for key in dotted_keys(CONFIGS[command]) if not key.startswith("input")}
        sections = {key.rpartition(".")[0] for key in keys}
        known = {*ALWAYS[command].split(), *OF_ALL}
        known |= {setting.partition("=")[0] for setting in IDLE.get(command, {})}
        assert keys - sections - known == set(), command


def test_keys_without_effect_are_errors_with_the_condition():
    for command, settings in IDLE.items():
        for setting, others in settings.items():
            key = setting.partition("=")[0]
            found = problems(command, [*others.split(" "), setting] if others else [setting])
            said = f"--set {setting}: `{key}` has no effect here, only "
            assert [line for line in found if line.startswith(said)], (command, setting, found)
            assert all(line.endswith("; leave it out") for line in found), found


def test_defaults_may_be_stated_whether_they_count_or_not():
    load("fit", ["posterior.widening=1", "search.max_cells=200000", "noise=null"])


def test_a_file_serves_another_method_that_the_command_line_chooses():
    Path("fit.yaml").write_text("method: posterior\nposterior: {widening: 1.5}\n")
    assert load("fit", ["method=convex"], Path("fit.yaml")).method == "convex"
    Path("fit.yaml").write_text("method: convex\nposterior:\n  widening: 1.5\n")
    (line,) = problems("fit", [], Path("fit.yaml"))
    assert line == (
        "fit.yaml:3:3: `posterior.widening` has no effect here, only with `method: posterior` or "
        "`method: sequences`; leave it out"
    )


def test_installed_configs_serve_other_methods():
    from shapefit.config import find_config

    people = find_config("fit", Path("people"))
    assert load("fit", ["method=convex"], people).posterior.widening == 1.6
    assert problems("fit", ["method=convex", "posterior.widening=2"], people)


@pytest.mark.parametrize("command", ["fit", "convert"])
def test_a_height_is_in_metres(command):
    (line,) = problems(command, ["height=178"])
    assert line == (
        "--set height=178: expected a height in metres, > 0 and at most 3, such as 1.78, found 178"
    )


@pytest.mark.parametrize(
    ("setting", "condition"),
    [
        ("flip=true", "only for 2D landmarks: the files hold 3D shapes"),
        ("prior.stretch=0.2", "only with `prior: {components: ...}`"),
    ],
)
def test_keys_of_learn_dict_that_do_not_count_for_shapes(project, tmp_path, setting, condition):
    shapes = project / "sample_data/people_train.h5"
    given = {"shapes": (str(shapes),), "output": str(tmp_path / "d.h5")}
    config = load_config("learn-dict", None, [setting], given)
    key = setting.partition("=")[0]
    with pytest.raises(InputError, match=re.escape(f"`{key}` has no effect here, {condition}")):
        list(learn_dict(config))


def test_a_key_that_is_gone_says_what_replaces_it():
    for command, keys in GONE.items():
        for key, instead in keys.items():
            found = problems(command, [f"{key}=3"])
            last = key.rpartition(".")[2]
            assert found == (f"--set {key}=3: unknown key {last!r}; it is gone: {instead}",)
