"""A fit part by part: the same bits as in one run, resumed where it stopped."""

import fcntl
import json
from pathlib import Path

import h5py
import pytest
from shapefit.cli.main import run as shapefit

from shapefit.config import dump_config, load_config
from shapefit.config.paths import ResultFolder
from shapefit.errors import InputError
from shapefit.io import write_shapes
from shapefit.io.records import ShapeSet
from shapefit.pipelines.fit.run import run as fit_whole
from shapefit.pipelines.parts import part
from shapefit.pipelines.parts import run as parts
from shapefit.pipelines.parts.run import run, tell_pace
from tests.pipelines.parts.made import NAMES, make_dictionary, make_images, same_bits
from tests.pipelines.told import done


@pytest.fixture
def folder(tmp_path, rng, monkeypatch) -> Path:
    """A folder with a dictionary and 500 images in two files."""
    make_dictionary(tmp_path / "dict.h5", rng)
    points = rng.normal(size=(500, 2, 8))
    monkeypatch.chdir(tmp_path)
    make_images("one.h5", points[:400])
    make_images("two.h5", points[400:], 400)
    return tmp_path


def fit(output: str, *overrides: str):
    """Run fit; return its outcomes."""
    arguments = {"landmarks": ("one.h5", "two.h5"), "dictionary": "dict.h5", "output": output}
    pipeline = run if output.endswith("/") else fit_whole
    return list(pipeline(load_config("fit", None, overrides, arguments)))


def manifest() -> dict:
    return json.loads(Path("out/manifest.json").read_text())


def names() -> list[str]:
    return sorted(path.name for path in Path("out").glob("*.h5"))


def stamps() -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in Path("out").glob("*.h5")}


def same_as_one_run() -> None:
    fit("whole.h5")
    same_bits(names(), "whole.h5")


def test_parts_are_the_same_bits_as_one_run(folder):
    assert done(fit("out/", "partition=100")) == 500
    # 400 images in parts of 128, which is 100 in whole stretches of 64, and one of 100
    assert [entry["images"] for entry in manifest()["parts"]] == [128, 128, 128, 16, 100]
    assert names() == [f"part-{n:05}.h5" for n in range(5)]
    same_as_one_run()


@pytest.mark.parametrize("name", ["manifest.json.h5", "part-00000.h5"])
def test_a_file_is_never_a_folder_of_results(folder, name):
    """A folder is known by its type, whatever the output is called: nothing else appears in it."""
    Path("part-00007.h5").write_text("of somebody else")
    before = {path.name for path in Path().iterdir()}
    assert shapefit(["fit", "one.h5", "-d", "dict.h5", "-o", name, "-q"]) == 0
    assert {path.name for path in Path().iterdir()} == before | {name}


@pytest.mark.parametrize("text", ["output: far/", "output: ./far/"])
def test_a_config_names_a_folder_as_the_command_line_does(folder, text):
    Path("c.yaml").write_text(f"landmarks: one.h5\ndictionary: dict.h5\n{text}\n")
    config = load_config("fit", Path("c.yaml"))
    assert config.output == ResultFolder(folder / "far")
    Path("again.yaml").write_text(dump_config(config))
    assert load_config("fit", Path("again.yaml")) == config


def test_what_is_done_stays(folder):
    fit("out/", "partition=100")
    before = stamps()
    assert done(fit("out/", "partition=100")) == 0
    assert stamps() == before


def test_only_missing_parts_are_done(folder):
    fit("out/", "partition=100")
    content = manifest()
    del content["parts"][1]
    Path("out/manifest.json").write_text(json.dumps(content))
    before = stamps()
    assert done(fit("out/", "partition=100")) == 128
    changed = [name for name, stamp in stamps().items() if stamp != before[name]]
    assert changed == ["part-00001.h5"]


def test_a_damaged_part_is_done_again(folder):
    fit("out/", "partition=100")
    part = Path("out/part-00002.h5")
    damaged = bytearray(part.read_bytes())
    damaged[2000:12000] = bytes(10000)
    part.write_bytes(damaged)
    Path("out/part-00001.h5").touch()
    outcomes = fit("out/", "partition=100")
    assert outcomes[0].warnings == ("damaged, and done again: part-00002.h5",)
    assert done(outcomes) == 128
    same_as_one_run()


def test_links_in_the_folder_are_replaced(folder):
    outside = Path("outside")
    outside.write_text("mine")
    Path("out").mkdir()
    for name in ("part-00001.h5", ".lock"):
        Path("out", name).symlink_to(outside.resolve())
    fit("out/", "partition=100")
    assert outside.read_text() == "mine"
    assert names() == [f"part-{n:05}.h5" for n in range(5)]


@pytest.mark.parametrize(
    ("name", "dataset", "again"), [("two.h5", "landmarks", 100), ("dict.h5", "atoms", 500)]
)
def test_what_was_made_of_a_changed_file_is_done_again(folder, name, dataset, again):
    fit("out/", "partition=100")
    with h5py.File(name, "a") as file:
        file[dataset][0] *= 1.5
    assert done(fit("out/", "partition=100")) == again


@pytest.mark.parametrize("change", ["lambda=0.2", "partition=200"])
def test_another_config_does_all_and_says_so(folder, change):
    fit("out/", "partition=100")
    outcomes = fit("out/", "partition=100", change)
    assert done(outcomes) == 500
    assert any("all parts are done again" in str(o.warnings) for o in outcomes)
    assert len(names()) == len(manifest()["parts"])
    same_as_one_run() if change.startswith("partition") else None


def test_a_dry_run_lists_and_writes_nothing(folder):
    (outcome,) = fit("out/", "partition=100", "dry_run=true")
    assert outcome.note == "5 parts to do, 0 done"
    assert len(outcome.listing) == 5
    assert not Path("out").exists()


def test_a_failing_part_is_listed_and_the_others_are_done(folder, monkeypatch):
    real = part.run
    tries = []

    def broken(config, rows, setup):
        if rows and rows.start == 256:
            tries.append(rows)
            raise OSError("the disk is full")
        return real(config, rows, setup)

    monkeypatch.setattr(part, "run", broken)
    outcomes = fit("out/", "partition=100")
    failures = [failure for outcome in outcomes for failure in outcome.failures]
    assert [failure.item for failure in failures] == ["part-00002.h5"]
    assert "rows 256 to 383" in failures[0].reason
    assert len(tries) == 3
    assert names() == ["part-00000.h5", "part-00001.h5", "part-00003.h5", "part-00004.h5"]
    monkeypatch.undo()
    monkeypatch.chdir(folder)
    assert done(fit("out/", "partition=100")) == 128
    same_as_one_run()


def test_a_corrupt_part_among_a_hundred(folder, rng):
    for number in range(100):
        make_images(f"many-{number:02}.h5", rng.normal(size=(3, 2, 8)), 3 * number)
    whole = Path("many-37.h5").read_bytes()
    Path("many-37.h5").write_bytes(whole[: len(whole) // 2])
    arguments = {"landmarks": "many-*.h5", "dictionary": "dict.h5", "output": "out/"}
    config = load_config("fit", None, ("partition=3",), arguments)
    outcomes = list(run(config))
    (failure,) = [failure for outcome in outcomes for failure in outcome.failures]
    assert failure.item == "part-00037.h5"
    assert failure.reason.startswith(f"{Path.cwd()}/many-37.h5: cannot be read")
    assert done(outcomes) == 99 * 3
    assert len(names()) == len(manifest()["parts"]) == 99
    Path("many-37.h5").write_bytes(whole)
    assert done(list(run(config))) == 3
    assert len(names()) == len(manifest()["parts"]) == 100


def test_a_second_run_into_the_folder_is_refused(folder):
    fit("out/", "partition=100")
    with Path("out/.lock").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        with pytest.raises(InputError, match="another run is writing results to it"):
            fit("out/", "partition=100")


@pytest.mark.parametrize("made", [True, False])
def test_a_folder_that_cannot_be_written_to_is_refused(folder, monkeypatch, made):
    if made:
        Path("out").mkdir()
    monkeypatch.setattr("shapefit.io.atomic.is_writable", lambda _: False)
    with pytest.raises(InputError, match="is not writable"):
        fit("out/", "partition=100")
    assert list(Path().glob("out/**/*")) == []


@pytest.mark.parametrize(
    ("output", "override", "message"),
    [
        ("out/", "partition=100", "is not a manifest of results"),
        ("free/", "export.folder=meshes", "is not written for a folder of results"),
        ("out.h5", "workers=2", "a cluster writes a folder of results"),
    ],
)
def test_outputs_that_are_refused(folder, output, override, message):
    Path("out").mkdir()
    Path("out/manifest.json").write_text("{}")
    with pytest.raises(InputError, match=message):
        fit(output, override)


def test_a_killed_run_goes_on(folder, monkeypatch):
    real = parts.fit_part

    def killed(job):
        if job.part.number == 3:
            raise KeyboardInterrupt
        return real(job)

    monkeypatch.setattr(parts, "fit_part", killed)
    with pytest.raises(KeyboardInterrupt):
        fit("out/", "partition=100")
    monkeypatch.undo()
    monkeypatch.chdir(folder)
    assert len(manifest()["parts"]) == 3
    assert done(fit("out/", "partition=100")) == 116
    same_as_one_run()


def test_the_folder_is_one_result(folder, rng):
    def command(*arguments: str) -> int:
        return shapefit([*arguments, "-q"])

    fit("out/", "partition=100")
    fit("whole.h5")
    for name, table in (("out/", "joined.csv"), ("whole.h5", "whole.csv")):
        assert command("convert", name, "-o", table) == 0
    assert Path("joined.csv").read_text() == Path("whole.csv").read_text()
    assert command("view", "out/", "-o", "page.html") == 0
    assert Path("page.html").stat().st_size > 10_000

    truth = ShapeSet(rng.normal(size=(500, 3, 8)), NAMES, tuple(f"i{n}" for n in range(500)))
    write_shapes(Path("truth.h5"), truth)
    assert command("eval", "out/", "whole.h5", "--truth", "truth.h5", "-o", "report") == 0
    report = Path("report/report.json").read_text()
    assert '"out"' in report
    assert '"whole"' in report
    lines = Path("report/per_image.csv").read_text().splitlines()
    own = [line.split(",", 1)[1] for line in lines if line.startswith("out,")]
    # the rows of a file stand together
    assert sorted(own) == sorted(
        line.split(",", 1)[1] for line in lines if line.startswith("whole,")
    )
    assert len(own) >= 500

    assert command("verify", "out", "-d", "dict.h5") == 0
    with h5py.File("out/part-00003.h5", "a") as file:
        file["objective"][2] *= 0.9
    assert command("verify", "out/", "-d", "dict.h5") == 1


def test_a_missing_or_shortened_result_is_done_again(folder):
    fit("out/", "partition=100")
    Path("out/part-00001.h5").unlink()
    with Path("out/part-00003.h5").open("r+b") as file:
        file.truncate(1000)
    assert done(fit("out/", "partition=100")) == 128 + 16
    same_as_one_run()


def test_a_dry_run_prints_a_line_per_part(folder, capsys):
    line = "fit one.h5 two.h5 -d dict.h5 -o out/ --set partition=200 --dry-run"
    assert shapefit(line.split()) == 0
    printed, told = capsys.readouterr()
    names = [each.partition(":")[0] for each in printed.splitlines()]
    assert names == [f"part-{n:05}.h5" for n in range(3)]
    assert "rows 256 to 399" in printed
    assert told.rstrip().endswith("3 parts to do, 0 done")
    assert len(told.splitlines()) == 1


@pytest.mark.parametrize(
    ("numbers", "line"),
    [
        ((0, 1, 0, 0, 0, 0.0), "0 of 1 part done"),
        ((12, 40, 1, 20_000, 10, 10.0), "12 of 40 parts done, 1 failed, 2,000 images/s, 27 s left"),
        ((2, 40, 0, 20_000, 2, 60.0), "2 of 40 parts done, 333 images/s, 19 min left"),
        ((1, 1001, 0, 3600, 1, 36.0), "1 of 1001 parts done, 100 images/s, 10.0 h left"),
        ((9, 10, 1, 900, 9, 1.0), "9 of 10 parts done, 1 failed, 900 images/s"),
    ],
)
def test_tells(numbers, line):
    assert tell_pace(*numbers) == line
