"""A fit part by part: the same bits as in one run, resumed where it stopped."""

import fcntl
import os
import signal
from pathlib import Path

import h5py
import pytest
from shapefit.cli.main import run as shapefit

from shapefit.config import load_config
from shapefit.config.paths import ResultFolder
from shapefit.errors import InputError
from shapefit.io import write_shapes
from shapefit.pipelines.fit.fit import fit as fit_whole
from shapefit.pipelines.partition import run as parting
from shapefit.pipelines.partition.run import find_parts
from shapefit.pipelines.partition.run import fit_parts as run
from shapefit.records import Shapes
from tests.pipelines.fitted import done, failures
from tests.pipelines.partition.made import (
    NAMES,
    entries,
    make_dictionary,
    make_images,
    same_bits,
)

OUT = Path("out")
MANIFEST = OUT / "manifest.jsonl"


@pytest.fixture(autouse=True)
def folder(tmp_path, rng, monkeypatch) -> Path:
    """A folder with a dictionary and 500 images in two files."""
    make_dictionary(tmp_path / "dict.h5", rng)
    points = rng.normal(size=(500, 2, 8))
    monkeypatch.chdir(tmp_path)
    make_images("one.h5", points[:400])
    make_images("two.h5", points[400:], 400)
    return tmp_path


def config_of(output, *overrides: str, landmarks=("one.h5", "two.h5")):
    arguments = {"landmarks": landmarks, "dictionary": "dict.h5", "output": output}
    return load_config("fit", None, overrides, arguments)


def fit(*overrides: str, output: str = "out/", landmarks=("one.h5", "two.h5"), **parts):
    """Run fit in parts of 128 images, which is 100 in whole stretches; return its
    outcomes.
    """
    folder = ResultFolder(Path(output).absolute(), **{"partition": 100, **parts})
    return list(run(config_of(folder, *overrides, landmarks=landmarks)))


def names() -> list[str]:
    return sorted(path.name for path in OUT.glob("*.h5"))


def stamps() -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in OUT.glob("*.h5")}


def same_as_one_run() -> None:
    list(fit_whole(config_of("whole.h5")))
    same_bits((OUT / name for name in names()), Path("whole.h5"))


def test_parts_are_files_and_row_ranges_with_the_bits_of_one_run():
    assert done(fit()) == 500
    assert [entry["images"] for entry in entries()] == [128, 128, 128, 16, 100]
    assert [entry["rows"] for entry in entries()][3:] == [[384, 400], None]
    assert names() == [f"part-{n:05}.h5" for n in range(5)]
    same_as_one_run()
    before = stamps()
    assert done(fit()) == 0
    assert stamps() == before


def test_the_gap_of_all_parts_is_said():
    said = []
    for _ in range(2):  # the second time all parts are there already
        *_, last = fit("method=convex")
        said.append((last.note, last.numbers))
    assert said[0] == said[1]
    gaps = []
    for name in names():
        with h5py.File(OUT / name) as file:
            gaps.append(file["relative_gap"][:].max())
    note, numbers = said[0]
    assert note == f"5 of 5 parts done, all optimal, largest gap {max(gaps):.1e}"
    assert numbers.images == 500
    assert numbers.optimal == 500
    assert numbers.not_optimal == 0
    assert numbers.largest_gap == max(gaps)
    assert not numbers.camera.perspective


def test_trusted_images_of_all_parts_are_counted(project):
    samples = project / "sample_data"
    arguments = {
        "landmarks": [samples / "people_views.csv", samples / "one_person.csv"],
        "dictionary": "people",
        "output": ResultFolder(OUT.absolute(), partition=100),
        "method": "posterior",
    }
    *_, last = run(load_config("fit", None, (), arguments))
    count = 0
    for name in names():
        with h5py.File(OUT / name) as file:
            count += int(file["trusted"][:].sum())
    assert last.numbers.images == 13
    assert last.numbers.trusted == count > 0
    assert sum(entry["trusted"] for entry in entries()) == count


def test_parts_without_a_gap_say_none():
    fit("method=convex")
    lines = MANIFEST.read_text().replace('"largest_gap"', '"of_another_version"')
    MANIFEST.write_text(lines)
    *_, last = fit("method=convex")
    assert last.note == "5 of 5 parts done"
    *_, last = fit("method=mean-shape", output="mean/")
    assert last.note == "5 of 5 parts done"
    assert last.numbers.largest_gap is None


class TestResuming:
    @pytest.mark.parametrize("harm", ["forget", "remove", "shorten"])
    def test_one_part_that_is_missing_or_damaged_is_done_again(self, harm):
        fit()
        if harm == "forget":
            lines = MANIFEST.read_bytes().splitlines(keepends=True)
            MANIFEST.write_bytes(
                b"".join(line for line in lines if b"part-00001.h5" not in line)
            )
        elif harm == "remove":
            (OUT / "part-00001.h5").unlink()
        else:
            os.truncate(OUT / "part-00001.h5", 1000)
        before = stamps()
        assert done(fit()) == 128
        changed = [
            name for name, stamp in stamps().items() if stamp != before.get(name)
        ]
        assert changed == ["part-00001.h5"]
        same_as_one_run()

    def test_a_new_file_adds_a_part_wherever_it_stands(self, rng):
        fit()
        before = stamps()
        make_images("more.h5", rng.normal(size=(3, 2, 8)), 900)
        assert done(fit(landmarks=("more.h5", "one.h5", "two.h5"))) == 3
        assert stamps() == before | {"part-00005.h5": stamps()["part-00005.h5"]}

    def test_a_failing_part_stops_no_other(self, monkeypatch):
        real = parting.write_lifted

        def broken(config, part, lifted):
            if part.rows and part.rows.start == 256:
                raise OSError("the disk is full")
            return real(config, part, lifted)

        monkeypatch.setattr(parting, "write_lifted", broken)
        (reason,) = failures(fit()).values()
        assert "rows 256 to 383" in reason
        assert [entry["status"] for entry in entries()] == [
            "done",
            "done",
            "failed",
            *["done"] * 2,
        ]
        assert names() == [
            entry["file"] for entry in entries() if entry["status"] == "done"
        ]
        monkeypatch.setattr(parting, "write_lifted", real)
        assert done(fit()) == 128
        same_as_one_run()

    def test_a_corrupt_file_among_many(self, rng):
        for number in range(5):
            make_images(f"many-{number}.h5", rng.normal(size=(3, 2, 8)), 3 * number)
        whole = Path("many-0.h5").read_bytes()
        Path("many-0.h5").write_bytes(whole[: len(whole) // 2])
        results = fit(landmarks="many-*.h5")
        (reason,) = failures(results).values()
        assert reason.startswith(f"{Path.cwd()}/many-0.h5: cannot be read")
        assert done(results) == 12
        Path("many-0.h5").write_bytes(whole)
        assert done(fit(landmarks="many-*.h5")) == 3

    def test_a_killed_run_lacks_what_was_in_flight(self, monkeypatch):
        real = parting.fit_part

        def killed(job):
            if job.part.file == "part-00003.h5":
                os.kill(os.getpid(), signal.SIGKILL)
            return real(job)

        child = os.fork()
        if child == 0:
            monkeypatch.setattr(parting, "fit_part", killed)
            fit()
            os._exit(1)
        assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL
        assert len(entries()) == 3
        with MANIFEST.open(
            "r+b"
        ) as file:  # and the last line was not written to its end
            file.truncate(MANIFEST.stat().st_size - 40)
        assert done(fit()) == 128 + 16 + 100
        same_as_one_run()


CAMERA = "[cam]\nmatrix = [[1000.0, 0, {}], [0, 1000.0, 0], [0, 0, 1]]\n"
BOTH = ("one.h5", "two.h5")


class TestResultsAreNotLost:
    @pytest.mark.parametrize(
        ("change", "landmarks", "overrides", "parts", "held", "again"),
        [
            (None, ("two.h5",), (), {}, "of one.h5", 0),
            (None, BOTH, ("lambda=0.2",), {}, "another config", 500),
            (None, BOTH, (), {"partition": 200}, "another config", 500),
            (("dict.h5", "atoms"), BOTH, (), {}, "another dictionary", 500),
            (("two.h5", "landmarks"), BOTH, (), {}, "two.h5 before it changed", 100),
        ],
    )
    def test_it_is_refused_without_replace(
        self, change, landmarks, overrides, parts, held, again
    ):
        fit()
        if change:
            with h5py.File(change[0], "a") as file:
                file[change[1]][0] *= 1.5
        before = stamps()
        with pytest.raises(InputError, match=rf"{held}.*--replace"):
            fit(*overrides, landmarks=landmarks, **parts)
        assert stamps() == before
        assert (
            done(fit(*overrides, landmarks=landmarks, replace=True, **parts)) == again
        )
        assert len(names()) == len(entries())

    def test_a_file_that_the_config_names_is_one_that_results_depend_on(self):
        keys = ("camera.calibration=camera.toml", "method=convex+refine")
        Path("camera.toml").write_text(CAMERA.format(1.0))
        fit(*keys)
        assert done(fit(*keys)) == 0
        Path("camera.toml").write_text(CAMERA.format(2.0))
        with pytest.raises(InputError, match=r"another camera\.calibration.*--replace"):
            fit(*keys)


class TestWhatIsRefusedOrReplaced:
    def test_a_second_run_into_the_folder(self):
        OUT.mkdir()
        with (OUT / ".lock").open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            with pytest.raises(
                InputError, match="another run is writing results to it"
            ):
                fit()

    @pytest.mark.parametrize("text", ["", "{}\n", "[]\n", '{"config": 1}\n[]\n'])
    def test_what_is_no_manifest(self, text):
        OUT.mkdir()
        MANIFEST.write_text(text)
        with pytest.raises(InputError, match="is not a manifest of results"):
            fit()


class TestParts:
    """Which parts there are; those of sequences hold whole ones."""

    @staticmethod
    def write(path: str, sequences: str) -> str:
        points = 9.0 + 0 * h5py.File("one.h5")["landmarks"][: len(sequences)]
        make_images(path, points.swapaxes(1, 2), sequences=tuple(sequences))
        return path

    @staticmethod
    def planned(*landmarks: str, method: str = "sequences", partition: int = 100_000):
        arguments = {"landmarks": landmarks, "dictionary": "people", "output": "out/"}
        return find_parts(
            load_config("fit", None, (f"method={method}",), arguments), partition
        )

    def test_are_cut_between_sequences(self):
        one = self.write("a.h5", "a" * 5 + "b" * 30 + "c" * 4 + "d" * 9)
        rows = [
            part.rows
            for part in self.planned(one, self.write("b.h5", "eee"), partition=10)
        ]
        assert rows == [(0, 35), (35, 48), None]

    def test_a_recording_of_many_files_is_one(self, project):
        frames = sorted(map(str, (project / "sample_data/openpose").glob("*.json")))
        (part,) = self.planned(*frames, method="posterior", partition=100)
        assert len(part.inputs) == len(frames)


def test_the_folder_is_one_result(rng):
    def command(*arguments: str) -> int:
        return shapefit([*arguments, "-q"])

    fit()
    list(fit_whole(config_of("whole.h5")))
    for name, table in (("out/", "joined.csv"), ("whole.h5", "whole.csv")):
        assert command("convert", name, "-o", table) == 0
    assert Path("joined.csv").read_text() == Path("whole.csv").read_text()
    assert command("view", "out/", "-o", "page.html") == 0
    assert Path("page.html").stat().st_size > 10_000

    truth = Shapes(
        rng.normal(size=(500, 3, 8)).swapaxes(1, 2),
        landmark_names=NAMES,
        items=tuple(f"i{n}" for n in range(500)),
    )
    write_shapes(Path("truth.h5"), truth)
    assert (
        command("eval", "out/", "whole.h5", "--truth", "truth.h5", "-o", "report") == 0
    )
    lines = Path("report/per_image.csv").read_text().splitlines()[1:]
    assert len(lines) >= 1000
    assert len({line.partition(",")[2] for line in lines}) == len(lines) / 2
    assert command("verify", "out", "-d", "dict.h5") == 0
    with Path("out/part-00003.h5").open("ab") as file:
        file.write(b"more")
    assert command("verify", "out/", "-d", "dict.h5") == 1
