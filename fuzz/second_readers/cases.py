"""Files as our readers and independent ones have them: good files, and files that were spoiled.

`python -m fuzz.second_readers --cases 20000 --data ../shared/data` runs many cases.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import NamedTuple

import numpy as np

from fuzz.campaign import in_child
from fuzz.csv_cases import spoiled_csv
from fuzz.detector_cases import spoil_file, write_detector_files
from fuzz.hdf5_cases import spoil_bytes
from fuzz.motion_cases import ANIPOSE, BVH, TRC, spoiled_text
from fuzz.tracker_cases import spoil_groups, write_tracker_files
from shapefit.arrays import Floats
from shapefit.errors import InputError, printable
from shapefit.io.foreign.items import read_recording
from shapefit.io.formats import group_inputs
from shapefit.io.options import AS_THEY_ARE

from . import of_text, of_trackers
from .of_trackers import Reading


def _text(rng: Random, path: Path) -> None:
    text = path.read_bytes().decode("utf-8", "surrogateescape")
    path.write_bytes(spoiled_text(rng, text).encode("utf-8", "surrogatepass"))


class Format(NamedTuple):
    """What reads files independently, what spoils them, and where there are good ones.

    real are below `formats` of the real data, made are written by `write_made`.
    """

    read: Callable[[Path], Reading]
    spoil: Callable[[Random, Path], object]
    real: tuple[str, ...] = ()
    made: tuple[str, ...] = ()


SMALL = 40_000
"""Bytes of files that are spoiled, where a format has such."""

ALONE = "refused by the other reader alone"

_DLC = "m3v1mp4DLC_resnet50_openfieldAug20shuffle1_30000"

FORMATS: dict[str, Format] = {
    "DeepLabCut CSV": Format(
        of_trackers.deeplabcut_csv,
        spoiled_csv,
        (
            *("dlc/labelled_CollectedData_LM.csv", "dlc/labelled_dlc_testdata.csv"),
            *("dlc/labelled_madlc_testdata.csv", f"dlc/{_DLC}.csv", "dlc/made_multi_animal_el.csv"),
            *("lightning_pose/CollectedData_mirror_mouse.csv", "lightning_pose/fly_Cam-A_rng0.csv"),
        ),
        ("table.csv",),
    ),
    "DeepLabCut HDF5": Format(
        of_trackers.deeplabcut_hdf5,
        spoil_groups,
        (
            *(f"dlc/{_DLC}.h5", "dlc/made_fixed_labelled_madlc_testdata.h5"),
            *("dlc/made_multi_animal_el.h5", "dlc/reachingDEMO_2D.h5", "dlc/reachingDEMO_3D.h5"),
        ),
    ),
    "SLEAP labels": Format(
        of_trackers.sleap_labels,
        spoil_groups,
        (
            *("sleap/minimal_instance.slp", "sleap/multiview.slp", "sleap/typical.slp"),
            "sleap/predictions_1.2.7_provenance_and_tracking.slp",
            "sleap/py_written_28_multiview3d.slp",
        ),
    ),
    "SLEAP analysis": Format(
        of_trackers.sleap_analysis,
        spoil_groups,
        (
            *("sleap/centered_pair_matlab_200.analysis.h5", "sleap/legacy_nodims.analysis.h5"),
            *("sleap/multi_matlab.analysis.h5", "sleap/simple_standard.analysis.h5"),
        ),
    ),
    "JABS": Format(of_trackers.jabs, spoil_groups, ("jabs/example_pose_est_v2.h5",)),
    "NWB": Format(
        of_trackers.nwb,
        spoil_groups,
        ("nwb/minimal.pose.nwb", "nwb/ndx_pose_0.3.0_one_camera.nwb"),
    ),
    "movement": Format(
        of_trackers.movement, spoil_groups, ("movement/fly_Cam-A_rng0_200.nc",), ("poses.nc",)
    ),
    "OpenPose": Format(
        of_text.openpose,
        spoil_file,
        ("openpose/cam01_json", "openpose/two_people_cam01_json"),
        ("openpose",),
    ),
    "COCO results": Format(
        of_text.coco_results,
        spoil_file,
        ("coco/results_fakekeypoints100.json",),
        ("results.json",),
    ),
    "COCO annotations": Format(
        of_text.coco_annotations,
        spoil_file,
        (
            *("coco/annotations_mixed_animals.json", "coco/annotations_val2017_subset.json"),
            "coco/annotations_visibility_ternary.json",
        ),
        ("annotations.json",),
    ),
    "Ultralytics": Format(of_text.ultralytics, spoil_file, ("ultralytics",), ("yolo",)),
    "MMPose": Format(of_text.mmpose, spoil_file, made=("mmpose.json",)),
    "caliscope": Format(
        of_text.caliscope, spoiled_csv, ("mediapipe/xy_HOLISTIC_first.csv",), ("xy.csv",)
    ),
    "anipose": Format(of_text.anipose, spoiled_csv, made=("anipose.csv",)),
    "long table": Format(of_text.long_table, spoiled_csv, made=("long.csv",)),
    "array": Format(of_text.array, spoil_bytes, made=("array.npy",)),
    "TRC": Format(
        of_text.trc,
        _text,
        ("motion/markers.trc", "motion/balancing_body25b.trc"),
        ("made.trc",),
    ),
    "BVH": Format(
        of_text.bvh, _text, ("motion/bvhio_example.bvh", "motion/test_freebvh.bvh"), ("made.bvh",)
    ),
    "C3D": Format(of_text.c3d_points, spoil_bytes, ("motion/runway03.c3d",)),
}
"""A format that is read gets a second reader by one entry here."""


def write_made(folder: Path) -> None:
    """Write small files of the formats."""
    write_tracker_files(folder)
    write_detector_files(folder)
    for name, text in {"anipose.csv": ANIPOSE, "made.trc": TRC, "made.bvh": BVH}.items():
        (folder / name).write_text(text)


def ours(path: Path) -> Reading:
    """Return the instances that our reader finds, frame by frame, with their confidences."""
    ((known, paths),) = group_inputs([path], AS_THEY_ARE)
    if known.recorder is None:
        raise InputError(f"is taken for {known.title}")
    recording = read_recording(known, paths)
    found: dict[tuple[str, int], list[Floats]] = {}
    scores = np.full(recording.points.shape[:2], np.nan)
    scores = scores if recording.confidence is None else recording.confidence
    rows = np.concatenate([recording.points, scores[..., None]], axis=-1)
    videos = recording.videos or [""] * len(recording)
    for video, frame, row in zip(videos, recording.frames.tolist(), rows, strict=True):
        found.setdefault((video, frame), []).append(row)
    return recording.landmark_names, [np.stack(each) for each in found.values()]


def difference(own: Reading, other: Reading) -> str:
    """Return in what two readings differ, nothing where they agree."""
    if own[0] is not None and other[0] is not None:
        other = tuple(map(printable, other[0])), other[1]
        if set(own[0]) != set(other[0]):
            return f"landmarks {own[0]} and {other[0]}"
        order = [other[0].index(name) for name in own[0]]
        other = own[0], [frame[:, order] for frame in other[1]]
    axes = own[1][0].shape[-1] - 1 if own[1] else 2
    mine, theirs = (_ordered(frames, axes) for _, frames in (own, other))
    if len(mine) != len(theirs):
        return f"{len(mine)} and {len(theirs)} frames with points"
    for number, (one, two) in enumerate(zip(mine, theirs, strict=True)):
        if one.shape[:2] != two.shape[:2]:
            return f"frame {number}: {one.shape[:2]} and {two.shape[:2]} instances, landmarks"
        scored = two.shape[-1] > axes
        same = np.isclose(one[..., : two.shape[-1]], two, rtol=1e-6, atol=1e-9, equal_nan=True)
        if not same[..., :axes].all() or (scored and not same[..., axes].all()):
            place = tuple(np.argwhere(~same)[0].tolist())
            return f"frame {number}, {place}: {one[place]} and {two[place]}"
    return ""


def _ordered(frames: list[Floats], axes: int) -> list[Floats]:
    """Return frames that have points, missing ones NaN throughout, instances by their numbers."""
    found = []
    for frame in frames:
        placed = np.isfinite(frame[..., :axes]).all(axis=-1, keepdims=True)
        frame[..., axes:] = np.nan_to_num(frame[..., axes:], nan=1.0)
        frame = np.where(placed, frame, np.nan)[placed.any(axis=(1, 2))]
        if len(frame):
            flat = np.nan_to_num(frame[..., :axes].reshape(len(frame), -1), nan=1e99)
            found.append(frame[np.lexsort(flat.T)])
    return found


def compare(known: Format, path: Path, started: Callable[[], object] = bool) -> str:
    """Return what comes of both readers: the first word is the kind of it.

    `started` is called before the other reader, which may crash.
    """
    try:
        own = ours(path)
    except InputError:
        return "refused"
    except Exception as error:
        return f"breaks: {error!r}"
    started()
    try:
        found = difference(own, known.read(path))
    except Exception:
        return ALONE
    return f"differs: {found}" if found else "equal"


def good_files(known: Format, data: Path, work: Path) -> list[Path]:
    """Return the good files and folders of a format."""
    return [*(data / name for name in known.real), *(work / name for name in known.made)]


def spoiled(seed: int, data: Path, work: Path) -> Iterator[tuple[str, Path, str]]:
    """Spoil one file of each format, and yield the format, the file and what comes of it."""
    for name, known in FORMATS.items():
        rng = Random(f"{name}{seed}")
        sources = good_files(known, data, work)
        small = [path for path in sources if path.is_dir() or path.stat().st_size < SMALL]
        source = rng.choice(small or sources)
        folder = work / "case"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        path = folder / source.name
        (shutil.copytree if source.is_dir() else shutil.copy)(source, path)
        with suppress(ValueError, IndexError, KeyError):  # changes that need what is not there
            known.spoil(rng, path)

        def work_on(path: Path = path, known: Format = known) -> int:
            warnings.simplefilter("ignore")
            print(f"\n{compare(known, path, lambda: print(ALONE, flush=True))}")
            return 0

        status, _ = in_child(work_on, folder)
        lines = (folder / "stdout").read_text("utf-8", "replace").strip().splitlines()
        ended = (
            lines[-1] if lines and (status == 0 or lines[-1] == ALONE) else f"ends with {status}"
        )
        yield name, source, ended


def main() -> int:
    """Run many cases, print what differs, and count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=20_000)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    arguments = parser.parse_args()
    data = arguments.data.resolve() / "formats"
    counts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        write_made(work)
        for known in FORMATS.values():  # imports what the forks need
            compare(known, good_files(known, data, work)[-1])
        for seed in range(arguments.first, arguments.first + -(-arguments.cases // len(FORMATS))):
            for name, source, found in spoiled(seed, data, work):
                kind = found.partition(":")[0]
                counts[kind] += 1
                if kind not in ("equal", "refused", ALONE):
                    print(f"{name} {seed} {source.name}: {found}", flush=True)
    print(f"{sum(counts.values())} cases: {dict(counts)}")
    return 1 if any(kind.startswith(("differs", "breaks", "ends")) for kind in counts) else 0
