"""Stand-ins for the pipelines, so that the command line is tested alone."""

import io
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from types import ModuleType, SimpleNamespace
from unittest.mock import patch

import pytest
from shapefit.cli.main import run


def run_in(folder: Path, *arguments: object, text: str = "") -> SimpleNamespace:
    """Run the command line in a folder, in this process, with a text as standard
    input.
    """
    stdin = io.TextIOWrapper(io.BytesIO(text.encode()))
    stdout = io.TextIOWrapper(io.BytesIO())
    with (
        chdir(folder),
        patch.object(sys, "stdin", stdin),
        redirect_stdout(stdout),
        redirect_stderr(io.StringIO()) as told,
    ):
        code = run([str(argument) for argument in arguments])
        stdout.flush()
    return SimpleNamespace(
        returncode=code,
        stdout=stdout.buffer.getvalue().decode(),
        stderr=told.getvalue(),
    )


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder with input files and a config of `fit`."""
    for name in ("views.h5", "dict.h5", "shapes.h5", "result.h5"):
        (tmp_path / name).touch()
    (tmp_path / "fit.yaml").write_text(
        "landmarks: views.h5\ndictionary: dict.h5\noutput: result.h5\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SHAPEFIT_TRACEBACK", "0")
    return tmp_path


@pytest.fixture
def fake_pipeline(monkeypatch):
    """Put a function in the place of a pipeline; return the configs it is given."""

    def install(name, outcomes):
        place, _, function = name.rpartition(".")
        configs = []

        def pipeline(config):
            configs.append(config)
            for outcome in outcomes:
                if isinstance(outcome, BaseException):
                    raise outcome
                yield outcome

        module = ModuleType(f"shapefit.pipelines.{place}")
        setattr(module, function, pipeline)
        monkeypatch.setitem(sys.modules, module.__name__, module)
        return configs

    return install


@pytest.fixture
def shapefit(folder, capsys):
    """Run the command line in this process."""

    def invoke(*arguments):
        code = run([str(argument) for argument in arguments])
        output = capsys.readouterr()
        return SimpleNamespace(code=code, out=output.out, err=output.err)

    return invoke
