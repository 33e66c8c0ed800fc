"""Archives of small files: several to a part, planned once, and a manifest that grows by lines."""

import json
import os
import shutil
import signal
from pathlib import Path

import h5py
import numpy as np
import pytest
from shapefit.cli.main import run as shapefit

from shapefit.config import load_config
from shapefit.config.paths import result_parts
from shapefit.pipelines.fit.run import run as fit_whole
from shapefit.pipelines.parts import equal_items, manifest, plan
from shapefit.pipelines.parts import run as parts
from shapefit.pipelines.parts.plan import plan_parts
from shapefit.pipelines.parts.run import run
from tests.pipelines.parts.made import make_dictionary, make_images, same_bits
from tests.pipelines.told import done, texts

FILES, IMAGES = 24, 5
MANIFEST = Path("out/manifest.json")
SAMPLES = Path(__file__).resolve().parents[3] / "sample_data"


@pytest.fixture(autouse=True)
def clips(tmp_path, rng, monkeypatch) -> None:
    """A dictionary, and images in many files."""
    monkeypatch.chdir(tmp_path)
    make_dictionary(Path("dict.h5"), rng)
    for number in range(FILES):
        make_clip(number, rng)


def make_clip(number: int, rng) -> None:
    make_images(f"clip-{number:02}.h5", rng.normal(size=(IMAGES, 2, 8)), number * IMAGES)


def config(output: str = "out/", *overrides: str, landmarks: str = "clip-*.h5"):
    given = {"landmarks": landmarks, "dictionary": "dict.h5", "output": output}
    return load_config("fit", None, overrides, given)


def fit(*overrides: str, landmarks: str = "clip-*.h5"):
    return list(run(config("out/", *overrides, landmarks=landmarks)))


def entries() -> list[dict]:
    return json.loads(MANIFEST.read_text())["parts"]


def same_as_one_run(landmarks: str = "clip-*.h5") -> None:
    list(fit_whole(config("whole.h5", landmarks=landmarks)))
    same_bits([entry["file"] for entry in entries()], "whole.h5")


def test_several_files_to_a_part_are_the_same_bits_as_one_run():
    assert done(fit("partition=50")) == FILES * IMAGES
    # A part is called after the number of its first file, and has as many as hold 50 images.
    assert [entry["file"] for entry in entries()] == [f"part-000{n}.h5" for n in ("00", "10", "20")]
    assert [entry["images"] for entry in entries()] == [50, 50, 20]
    same_as_one_run()


def test_the_folder_is_verified():
    fit("partition=50")
    Path("clips").mkdir()
    landmarks = [
        word for path in sorted(Path().glob("clip-*.h5")) for word in ("--landmarks", path)
    ]
    command = ["verify", "out", "-d", "dict.h5", "-q", *map(str, landmarks)]
    assert shapefit(command) == 0
    assert shapefit(command[:-2]) == 1  # without the last file
    content = json.loads(MANIFEST.read_text())
    del content["parts"][1]
    MANIFEST.write_text(json.dumps(content))
    assert shapefit(command) == 1


def test_a_damaged_file_is_found_among_its_neighbours():
    whole = Path("clip-17.h5").read_bytes()
    Path("clip-17.h5").write_bytes(whole[: len(whole) // 2])
    outcomes = fit()
    (failure,) = [failure for outcome in outcomes for failure in outcome.failures]
    assert failure.item == "part-00017.h5"
    assert failure.reason.startswith(f"{Path.cwd()}/clip-17.h5: cannot be read")
    assert done(outcomes) == (FILES - 1) * IMAGES
    assert "part-00017.h5" not in [entry["file"] for entry in entries()]
    assert len(entries()) < FILES / 2
    Path("clip-17.h5").write_bytes(whole)
    assert done(fit()) == IMAGES
    same_as_one_run()


def test_files_that_do_not_go_together_are_parts_of_their_own(rng):
    make_clip(0, rng)
    shutil.copy("clip-00.h5", "clip-01.h5")  # the same names
    with h5py.File("clip-05.h5", "a") as file:
        file.attrs["unit"] = "px"
    outcomes = fit()
    assert not [failure for outcome in outcomes for failure in outcome.failures]
    assert done(outcomes) == FILES * IMAGES
    (warning,) = [told for told in texts(outcomes) if "more than one part" in told]
    assert warning.startswith(f"{IMAGES} items in more than one part")


def looked_into(monkeypatch) -> list[str]:
    """Return a list to which the files are added that planning looks into."""
    seen: list[str] = []
    real = plan.begins_with
    monkeypatch.setattr(
        plan, "begins_with", lambda path, *known: seen.append(path.name) or real(path, *known)
    )
    return seen


def test_a_second_run_asks_only_for_what_changed(monkeypatch, rng):
    fit("partition=700")  # of small files the number of images is guessed
    own = [len(entry["inputs"]) for entry in entries()]
    assert 1 < own[0] < FILES
    before = {path.name: path.stat().st_mtime_ns for path in Path("out").glob("part-*")}
    seen = looked_into(monkeypatch)
    assert done(fit("partition=700")) == 0
    assert seen == []
    make_clip(1, rng)
    assert done(fit("partition=700")) == own[0] * IMAGES
    assert len(seen) == own[0]
    after = {path.name: path.stat().st_mtime_ns for path in Path("out").glob("part-*")}
    assert [name for name in before if after[name] != before[name]] == ["part-00000.h5"]
    make_clip(FILES, rng)
    seen.clear()
    assert done(fit("partition=700")) == IMAGES
    assert seen == [f"clip-{FILES}.h5"]
    same_as_one_run()


def test_a_recording_that_grew_is_one_recording_still():
    """Frames that are added to a folder of one file each belong to what is known of the folder."""
    frames = sorted((SAMPLES / "openpose").glob("*.json"))
    given = {"dictionary": "people", "output": "out/"}
    keys = ("keypoints=body_25",)

    def planned(count: int, known=()):
        landmarks = tuple(map(str, frames[:count]))
        return plan_parts(load_config("fit", None, keys, given | {"landmarks": landmarks}), known)

    (first,) = planned(10)
    (grown,) = planned(11, [first.describe()])
    assert len(grown.inputs) == 11


class TestNamesInAnyOrder:
    @pytest.fixture(autouse=True)
    def shuffled(self, rng):
        """The same names, in any order over the files."""
        order = rng.permutation(FILES * IMAGES)
        for number in range(FILES):
            with h5py.File(f"clip-{number:02}.h5", "a") as file:
                own = order[number * IMAGES :][:IMAGES]
                del file["item"]
                file["item"] = np.array([f"i{n}" for n in own], "S")

    @staticmethod
    def readings(monkeypatch) -> list[str]:
        seen: list[str] = []
        real = equal_items._items
        monkeypatch.setattr(
            equal_items, "_items", lambda part: seen.append(part.name) or real(part)
        )
        return seen

    def test_cost_no_second_pass(self, monkeypatch):
        seen = self.readings(monkeypatch)
        outcomes = fit("partition=50")
        assert seen == []
        assert not [told for told in texts(outcomes) if "more than one part" in told]

    def test_of_an_earlier_run_are_read_once(self, monkeypatch):
        fit("partition=50", landmarks="clip-[01]*.h5")
        seen = self.readings(monkeypatch)
        with h5py.File("clip-00.h5") as one, h5py.File("clip-23.h5", "a") as other:
            other["item"][0] = one["item"][0]
        (warning,) = [told for told in texts(fit("partition=50")) if "more than one part" in told]
        assert warning.startswith("1 item in more than one part")
        assert not [told for told in texts(fit("partition=50")) if "more than one part" in told]
        assert sorted(seen[:2]) == ["part-00000.h5", "part-00010.h5"]


class TestTheManifest:
    def test_grows_by_a_line_for_each_part(self, monkeypatch):
        written = []
        real = manifest.Manifest.write
        monkeypatch.setattr(manifest.Manifest, "write", lambda *own: written.append(real(*own)))
        fit("partition=5")
        assert len(written) == 2  # at the start, and in order at the end
        assert len(MANIFEST.read_text().splitlines()) == FILES + 2

    def test_is_whole_but_for_a_line_that_was_cut_short(self):
        fit("partition=5")
        text = MANIFEST.read_bytes()
        whole = json.loads(text)
        last, written = text.rindex(b"\n,") + 1, text.rindex(b"]}")
        for end in range(last, len(text)):
            known = FILES if end in (written, len(text) - 1) else FILES - 1
            assert manifest.parse(text[:end]) == whole | {"parts": whole["parts"][:known]}

    def test_of_a_killed_run_lacks_what_was_in_flight(self, monkeypatch):
        real = parts.fit_part

        def killed(job):
            if job.part.number == 7:
                os.kill(os.getpid(), signal.SIGKILL)
            return real(job)

        child = os.fork()
        if child == 0:
            monkeypatch.setattr(parts, "fit_part", killed)
            fit("partition=5")
            os._exit(1)
        assert os.WTERMSIG(os.waitpid(child, 0)[1]) == signal.SIGKILL
        assert len(entries()) == 7
        with MANIFEST.open("r+b") as file:  # and the last entry was not written to its end
            file.truncate(MANIFEST.stat().st_size - 40)
        assert done(fit("partition=5")) == (FILES - 6) * IMAGES
        same_as_one_run()

    def test_lists_parts_in_the_order_of_their_numbers(self):
        names = [f"part-{number}.h5" for number in ("09999", "10000", "99999", "100000")]
        content = {"parts": [{"file": name} for name in reversed(names)]}
        Path("out").mkdir()
        MANIFEST.write_text(json.dumps(content))
        assert [path.name for path in result_parts(Path("out"))] == names

    def test_of_the_first_version_is_taken_up(self):
        fit("partition=5")
        content = json.loads(MANIFEST.read_text())
        MANIFEST.write_text(json.dumps(content | {"version": 1}, indent=1))
        assert shapefit(["verify", "out", "-d", "dict.h5", "-q"]) == 0
        assert done(fit("partition=5")) == 0
