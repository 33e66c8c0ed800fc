"""The config of sweep: its sections, and what it does not accept, with the place of each."""

import pytest

from shapefit.config import FitConfig, SweepConfig, dump_config, load_config
from shapefit.errors import InputError

SWEEP = """\
learn_dict:
  shapes: train.h5
  k: 8
project: {shapes: test.h5}
fit:
  lambda: 0.1
truth: test.h5
vary: {fit.lambda: [0.1, 0.2]}
output: out
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a config and its files; the working directory is another one."""
    configs = tmp_path / "configs"
    configs.mkdir()
    for name in ("train.h5", "test.h5", "dict.h5"):
        (configs / name).touch()
    (configs / "sweep.yaml").write_text(SWEEP)
    monkeypatch.chdir(tmp_path)
    return configs


def load(folder, *options):
    return load_config("sweep", folder / "sweep.yaml", options)


def problems(folder, *options):
    with pytest.raises(InputError) as caught:
        load(folder, *options)
    return caught.value.problems


def edit(folder, old, new):
    assert old in SWEEP
    (folder / "sweep.yaml").write_text(SWEEP.replace(old, new))


def test_paths_in_sections_are_relative_to_the_file(folder):
    config = load(folder)
    assert isinstance(config, SweepConfig)
    assert config.learn_dict.shapes == (folder / "train.h5",)
    assert config.project.shapes == config.truth == (folder / "test.h5",)
    assert config.output == folder / "out"


def test_data_stands_in_sections_too(folder):
    edit(
        folder,
        "learn_dict:\n  shapes: train.h5",
        f"data: {folder}\nlearn_dict:\n  shapes: '{{data}}/train.h5'",
    )
    assert load(folder).learn_dict.shapes == (folder / "train.h5",)


def test_steps_differ_in_the_key_alone(folder):
    config = load(folder)
    first, second = map(config.steps, config.values)
    assert (first.fit.lam, second.fit.lam) == (0.1, 0.2)
    assert first.fit == second.fit.model_copy(update={"lam": 0.1})
    assert first[:2] == second[:2] == (config.learn_dict, config.project)
    deep = load(folder, "vary={fit.solver.tolerance: [1e-3]}")
    assert deep.steps(1e-3).fit.solver.tolerance == 1e-3
    assert deep.fit.solver.tolerance == 1e-6


def test_a_section_may_be_a_path_whose_files_the_sweep_makes(folder):
    (folder / "fit.yaml").write_text(
        "landmarks: absent.h5\ndictionary: absent.h5\noutput: result.h5\nlambda: 0.3\n"
    )
    edit(folder, "fit:\n  lambda: 0.1", "fit: fit.yaml")
    config = load(folder)
    assert isinstance(config.fit, FitConfig)
    assert config.fit.lam == 0.3


def test_data_reaches_a_section_that_is_a_path(folder):
    (folder / "project.yaml").write_text("shapes: '{data}/test.h5'\noutput: views.h5\n")
    edit(folder, "project: {shapes: test.h5}", "project: project.yaml")
    config = load(folder, f"data={folder}")
    assert config.project.shapes == (folder / "test.h5",)


def test_the_printed_config_loads_again(folder):
    config = load(folder)
    (folder / "printed.yaml").write_text(dump_config(config), encoding="utf-8")
    assert load_config("sweep", folder / "printed.yaml") == config


@pytest.mark.parametrize(
    ("old", "new", "line", "expected"),
    [
        ("k: 8", "k: none", "3:6", "expected a whole number >= 1, found 'none'"),
        ("k: 8", "kk: 8", "3:3", "unknown key 'kk'"),
        ("lambda: 0.1", "lambda: -1", "6:11", "expected a number > 0 or auto, found -1"),
        ("lambda: 0.1", "lamda: 1", "6:3", "unknown key 'lamda'; did you mean 'lambda'?"),
        ("[0.1, 0.2]", "[0.1, -2]", "8:7", "fit.lambda=-2: expected a number > 0 or auto"),
        ("[0.1, 0.2]", "[]", "8:7", "expected different values of fit.lambda, found []"),
        ("[0.1, 0.2]", "[1, 1]", "8:7", "expected different values of fit.lambda, found [1, 1]"),
        ("fit.lambda:", "lambda:", "8:7", "expected a key of learn_dict, project, fit, corrupt"),
        ("fit.lambda:", "fit.lamda:", "8:7", "fit.lamda=0.1: unknown key 'lamda'"),
        ("fit.lambda:", "fit.export.unit:", "8:7", "a sweep writes no meshes and pictures, so"),
        ("fit.lambda:", "fit.dictionary:", "8:7", "fit.dictionary is a path; only settings can"),
        ("0.2]}", "0.2], project.noise: [0]}", "8:7", "expected one key with its values, found 2"),
    ],
)  # fmt: skip
def test_a_problem_has_its_place(folder, old, new, line, expected):
    edit(folder, old, new)
    (problem,) = problems(folder)
    assert problem.startswith(f"{folder}/sweep.yaml:{line}: {expected}")


@pytest.mark.parametrize(
    ("vary", "expected"),
    [
        (
            "fit.method: [alternate]",
            'with fit.method="alternate", fit.loss: '
            "the method alternate does not support `loss: exact`; use another, or `method: convex`",
        ),
    ],
)
def test_a_key_that_does_not_go_with_a_value_has_its_path(folder, vary, expected):
    edit(folder, "lambda: 0.1", "loss: exact")
    (problem,) = problems(folder, f"vary={{{vary}}}")
    assert problem == f"--set vary={{{vary}}}: {expected}"


@pytest.mark.parametrize(
    ("step", "expected"),
    [
        ("project: {shapes: test.h5}\n", "missing key 'landmarks'; name a file, or give `project`"),
        (
            "learn_dict:\n  shapes: train.h5\n  k: 8\n",
            "missing key 'dictionary'; name a file, or give `learn_dict`",
        ),
    ],
)
def test_what_no_step_makes_must_be_named(folder, step, expected):
    edit(folder, step, "")
    assert [line for line in problems(folder) if line.endswith(expected)]


def test_a_key_of_an_absent_step_cannot_vary(folder):
    edit(folder, "learn_dict:\n  shapes: train.h5\n  k: 8\n", "")
    options = (f"fit.dictionary={folder / 'dict.h5'}", "vary={learn_dict.k: [8]}")
    (problem,) = problems(folder, *options)
    assert problem.endswith("`learn_dict` is not given, so that learn_dict.k cannot vary")


def test_a_problem_in_the_file_of_a_section_has_both_places(folder):
    (folder / "fit.yaml").write_text("output: result.h5\nlambda: 0\n")
    edit(folder, "fit:\n  lambda: 0.1", "fit: fit.yaml")
    (problem,) = problems(folder)
    place = f"{folder}/sweep.yaml:5:6: {folder}/fit.yaml:2:9: "
    assert problem == f"{place}expected a number > 0 or auto, found 0"


PAPER = ["lambda", "noise", "hidden", "k"]


@pytest.mark.parametrize("name", [*(f"sensitivity-{key}" for key in PAPER), "timing", "timing-pmp"])
def test_the_configs_of_the_paper_are_right_but_for_files(project, tmp_path, name):
    present = tmp_path / "present.h5"
    present.touch()
    path = project / f"configs/paper/{name}.yaml"
    section = {"shapes": str(present)}
    given = {"landmarks": str(present), "dictionary": str(present)}
    key = name.removeprefix("sensitivity-")
    arguments = {"truth": str(present), "fit": given}
    if key in ("noise", "hidden"):
        arguments["project"] = section
    if key == "k":
        arguments["learn_dict"] = section
    config = load_config("sweep", path, (), arguments)
    assert config.output == project / "results/paper" / name
