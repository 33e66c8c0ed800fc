"""What stands in a folder is not lost: results of others, races, changes, edits."""

import json
import os
import random
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from shapefit.cli.main import run as shapefit

from shapefit.pipelines.fit import fit as fitting
from shapefit.pipelines.partition import together
from tests.pipelines.partition.made import entries, make_dictionary, make_images

FIT = ("fit", "-d", "dict.h5", "-o", "out/", "--method", "alternate", "-q")
OUT = Path("out")
MANIFEST = OUT / "manifest.jsonl"


@pytest.fixture(autouse=True)
def folder(tmp_path, rng, monkeypatch) -> Path:
    """A folder with a dictionary and two files of images."""
    monkeypatch.chdir(tmp_path)
    make_dictionary(tmp_path / "dict.h5", rng)
    make_images("one.h5", rng.normal(size=(20, 2, 8)))
    make_images("two.h5", rng.normal(size=(20, 2, 8)), 100)
    return tmp_path


def fit(*arguments: str, images: tuple[str, ...] = ("one.h5",)) -> int:
    return shapefit([FIT[0], *images, *FIT[1:], *arguments])


def contents(folder: Path = OUT) -> dict[str, bytes]:
    """Return the files of a folder."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


class TestResultsOfOthers:
    """Parts that no manifest lists are refused without --replace."""

    def check_refused(self, capsys, text: str) -> None:
        before = contents()
        assert fit(images=("two.h5",)) == 2
        said = capsys.readouterr().err
        assert text in said
        assert "--replace" in said
        assert contents() == before
        assert fit("--replace", images=("two.h5",)) == 0
        assert [entry["images"] for entry in entries()] == [20]
        assert sorted(p.name for p in OUT.glob("part-*")) == ["part-00000.h5"]

    def test_the_manifest_was_deleted(self, capsys):
        assert fit() == 0
        MANIFEST.unlink()
        self.check_refused(capsys, "part-00000.h5, which no manifest.jsonl lists")

    def test_parts_of_other_names_and_formats(self, capsys):
        OUT.mkdir()
        for name in ("part-00003.h5", "part-00000.parquet", "part-12.csv"):
            (OUT / name).write_text("somebody's")
        self.check_refused(capsys, "part-00000.parquet, part-00003.h5, part-12.csv,")

    def test_a_folder_of_version_0_2(self, capsys):
        OUT.mkdir()
        (OUT / "part-00000.h5").write_text("somebody's")
        (OUT / "manifest.json").write_text('{"version": "0.2.0", "parts": []}')
        self.check_refused(capsys, "an earlier version of shapefit (manifest.json)")
        assert not (OUT / "manifest.json").exists()

    def test_one_beside_those_of_a_manifest(self, capsys):
        assert fit() == 0
        (OUT / "part-00001.h5").write_text("somebody's")
        before = contents()
        assert fit(images=("one.h5", "two.h5")) == 2
        assert "part-00001.h5, which no manifest.jsonl lists" in capsys.readouterr().err
        assert contents() == before

    def test_a_part_that_a_killed_run_wrote_is_ours(self):
        """It was written, and its line was not."""
        assert fit(images=("one.h5", "two.h5")) == 0
        run, *parts = MANIFEST.read_text().splitlines()
        MANIFEST.write_text(f"{run}\n{parts[0]}\n")
        assert fit(images=("one.h5", "two.h5")) == 0
        assert len(entries()) == 2

    def test_what_a_killed_run_did_not_remove_is_ours(self, monkeypatch):
        """With --replace, between the new manifest and the end of an old part."""
        assert fit(images=("one.h5", "two.h5")) == 0
        real = Path.unlink

        def killed(path, **keys):
            if path.name.startswith("part-"):
                os._exit(9)
            real(path, **keys)

        child = os.fork()
        if child == 0:
            monkeypatch.setattr(Path, "unlink", killed)
            fit("--replace", images=("one.h5",))
            os._exit(1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 9
        assert fit(images=("one.h5",)) == 0
        assert sorted(p.name for p in OUT.glob("part-*")) == ["part-00000.h5"]


class TestOneRunAtATime:
    def test_the_plan_is_made_under_the_lock(self, monkeypatch):
        """Another run that ends between plan and lock would be replaced."""
        from shapefit.pipelines.partition import run as parting

        seen = []
        real = parting.read_manifest

        def read(folder):
            command = [sys.executable, "-m", "shapefit", FIT[0], "two.h5", *FIT[1:]]
            seen.append(subprocess.run(command, capture_output=True, check=False))
            return real(folder)

        monkeypatch.setattr(parting, "read_manifest", read)
        assert fit() == 0
        (other,) = seen
        assert other.returncode == 2
        assert b"another run is writing results to it" in other.stderr
        assert entries()[0]["inputs"] == [f"{Path.cwd()}/one.h5"]

    def test_a_refused_run_leaves_no_folder(self):
        Path("broken.h5").write_bytes(b"no landmarks")
        assert fit("-o", "deep/er/", images=("broken.h5",)) == 2
        assert not Path("deep").exists()

    def test_a_lock_that_another_run_removed_is_made_again(self, monkeypatch):
        """Between opening and locking it."""
        import fcntl

        from shapefit.pipelines.partition.manifest import hold_lock

        real, calls = fcntl.flock, []

        def removed_first(file, how):
            if not calls:
                (OUT / ".lock").unlink()
                OUT.rmdir()
            calls.append(file)
            real(file, how)

        monkeypatch.setattr(fcntl, "flock", removed_first)
        with hold_lock(OUT):
            assert (OUT / ".lock").exists()
        assert len(calls) == 2


def rewrite(path: Path) -> None:
    """Write a file anew, at another time."""
    path.write_bytes(path.read_bytes())
    os.utime(path, ns=(1, 1))


class TestInputsThatChange:
    @pytest.fixture
    def lift(self, monkeypatch):
        """Return what lets something happen while images are lifted."""

        def while_lifting(change) -> None:
            real = fitting.lift_batch
            changed = []

            def lift_batch(*given, **keys):
                if not changed:
                    change()
                changed.append(given)
                return real(*given, **keys)

            for module in (fitting, together):
                monkeypatch.setattr(module, "lift_batch", lift_batch)

        return while_lifting

    @pytest.mark.parametrize("name", ["one.h5", "dict.h5"])
    def test_its_part_fails(self, lift, capsys, name):
        lift(lambda: rewrite(Path(name)))
        assert fit(images=("one.h5", "two.h5")) == 1
        assert f"{name}: changed while it was read" in capsys.readouterr().err
        by_file = {entry["file"]: entry["status"] for entry in entries()}
        assert by_file["part-00000.h5"] == "failed"
        assert not (OUT / "part-00000.h5").exists()
        if name == "one.h5":
            assert by_file["part-00001.h5"] == "done"
            assert fit(images=("one.h5", "two.h5")) == 0

    def test_a_file_of_a_folder(self, lift, capsys, project):
        recording = Path("rec")
        shutil.copytree(project / "sample_data/openpose", recording)
        frames = sorted(recording.iterdir())
        lift(lambda: rewrite(frames[3]))
        keys = ("-o", "out/", "--method", "mean-shape", "-q")
        assert shapefit(["fit", "rec", "-d", "people", *keys]) == 1
        assert "changed while it was read" in capsys.readouterr().err

    def test_a_fit_of_one_file_is_refused(self, lift, capsys):
        assert fit("-o", "whole.h5") == 0
        before = Path("whole.h5").read_bytes()
        lift(lambda: rewrite(Path("one.h5")))
        assert fit("-o", "whole.h5") == 2
        assert "one.h5: changed while it was read" in capsys.readouterr().err
        assert Path("whole.h5").read_bytes() == before


VALUES = (
    None,
    -1,
    0,
    1.5,
    2**70,
    "",
    "x",
    "a\0b",
    "\ud800",
    "../x",
    [],
    [1],
    {},
    True,
    "done",
    "failed",
    "part-00000.h5",
    [["a"]],
    {"a": {}},
    float("nan"),
)
"""What stands in the place of a value."""


def places(value, way=()):
    """Yield the ways to every value in JSON."""
    steps = value.items() if isinstance(value, dict) else []
    steps = enumerate(value) if isinstance(value, list) else steps
    for step, inner in steps:
        yield (*way, step)
        yield from places(inner, (*way, step))


def edit(lines: list, rng: random.Random) -> None:
    """Delete a value of a manifest, or put another in its place."""
    line = rng.choice(lines)
    *way, last = rng.choice(list(places(line)))
    for step in way:
        line = line[step]
    if rng.random() < 0.3:
        del line[last]
    else:
        line[last] = rng.choice(VALUES)


COMMANDS = (
    (*FIT[:1], "one.h5", "two.h5", *FIT[1:]),
    ("info", "out/"),
    ("verify", "out/", "-d", "dict.h5"),
    ("convert", "out/", "-o", "joined.csv"),
)


class TestTheManifestIsReadByAModel:
    @pytest.fixture
    def lines(self) -> list:
        assert fit("--method", "auto", images=("one.h5", "two.h5")) == 0
        return [json.loads(line) for line in MANIFEST.read_text().splitlines()]

    def check(self, text: bytes, capsys) -> None:
        for command in COMMANDS:
            MANIFEST.write_bytes(text)
            code = shapefit(command)
            said = capsys.readouterr().err
            assert code in (0, 1, 2), (command, text, said)
            assert "Internal error" not in said

    def test_edits_are_refused(self, lines, capsys):
        for seed in range(40):
            changed = json.loads(json.dumps(lines))
            edit(changed, random.Random(seed))
            text = "".join(json.dumps(line) + "\n" for line in changed)
            self.check(text.encode(), capsys)

    @pytest.mark.parametrize("key", ["estimated", "method", "shapefit"])
    def test_a_run_that_lacks_a_key(self, lines, capsys, key):
        del lines[0][key]
        MANIFEST.write_text("".join(json.dumps(line) + "\n" for line in lines))
        assert fit(images=("one.h5", "two.h5")) == 2
        said = capsys.readouterr().err
        assert f"manifest.jsonl:1: is not a manifest of results ({key}: " in said

    @pytest.mark.parametrize(
        "key", ["file", "inputs", "rows", "states", "status", "bytes", "images"]
    )
    def test_a_part_that_lacks_a_key(self, lines, capsys, key):
        del lines[2][key]
        MANIFEST.write_text("".join(json.dumps(line) + "\n" for line in lines))
        assert fit(images=("one.h5", "two.h5")) == 2
        said = capsys.readouterr().err
        assert "manifest.jsonl:3: is not a manifest of results" in said
        assert key in said

    @pytest.mark.parametrize(
        "line",
        [
            b"[" * 100_000 + b"]" * 100_000,
            b'{"shapefit": "0", "estimated": ' + b'{"a":' * 50_000,
            b'{"file": "part-00000.h5\\u0000"}',
            b'{"file": "\\ud800"}',
            b"\xff\xfe",
            b"null",
            b"1" * 10_000,
        ],
    )
    def test_lines_that_no_run_writes(self, lines, capsys, line):
        first = json.dumps(lines[0]).encode()
        self.check(first + b"\n" + line + b"\n", capsys)
        self.check(line + b"\n", capsys)


def test_states_of_folders(tmp_path):
    from shapefit.io.inputs import find_state

    inner = tmp_path / "inner"
    inner.mkdir()
    assert find_state(tmp_path / "missing") == (0, 0)
    (inner / "a").write_text("abc")
    before = find_state(inner)
    (inner / ".hidden.partial").write_text("abc")
    assert find_state(inner) == before
    (inner / "a").rename(inner / "b")
    assert find_state(inner) != before
    os.mkfifo(tmp_path / "pipe")
    assert find_state(tmp_path / "pipe") == (0, 0)
    assert np.all(np.array(before) > 0)
