"""The table of file formats: how a file is recognised, what it holds, who reads and writes it.

A format is one row of `FORMATS`, or of `WRITTEN` where it is only written. Readers and writers are
imported when the first of them is called, as many runs need none.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from difflib import get_close_matches
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from shapefit.errors import abbreviate, input_error, listed
from shapefit.io import detect
from shapefit.io.detect import Head, has_hdf5, in_folder
from shapefit.io.inputs import HDF5_SIGNATURE, is_stream, require_file, source_name
from shapefit.io.layout import LANDMARKS, RESULTS, Layout
from shapefit.io.options import AS_KNOWN, InputOptions, OutputOptions
from shapefit.io.records import LandmarkSet, ResultSet
from shapefit.io.writer import RecordWriter
from shapefit.threads import on_threads

Output = AbstractContextManager[RecordWriter[Any]]


@dataclass(frozen=True)
class FileFormat:
    """A format of files.

    title        what a file of it is called, with its article
    suffixes     endings of its names; files of these names are taken for it first, and an output of
                 such a name is written in it
    records      the kinds (landmarks, shapes, ...) that it can hold; the content of a file decides
    recognise    whether a file with such a head is in this format
    read_poses   of a format of another tool: takes the paths that belong together, returns Poses
    together     files of one folder are one recording: a frame each, or parts that need each other
    folders      a folder is an input, too
    read_records of our own: takes a path and a kind, and `gaps` (whether landmarks may be unknown)
    holds        of our own: takes a path, returns the kind of what the file holds
    write        takes a path and the layout of the records, gives a RecordWriter in a `with`
    writes       the kinds that it can write
    in_metres    what it writes is in metres and upright, a sequence a file; `write` takes
                 OutputOptions, too
    angles       it is written with the joint angles of bodies, or holds nothing else
    points_only  it has no place for what is not a point: attributes, further datasets
    states_y_axis  whether y points up or down is known of each of its files
    """

    title: str
    suffixes: tuple[str, ...]
    records: tuple[str, ...] = ()
    recognise: Callable[[Head], bool] = lambda head: False
    read_poses: Callable[[tuple[Path, ...]], Any] | None = None
    together: bool = False
    folders: bool = False
    read_records: Callable[..., Any] | None = None
    holds: Callable[[Path], str] | None = None
    write: Callable[..., Output] | None = None
    writes: tuple[str, ...] = ()
    in_metres: bool = False
    angles: bool = False
    points_only: bool = True
    states_y_axis: bool = True

    def has_suffix(self, path: Path) -> bool:
        """Whether the path is named like a file of this format."""
        return path.name.lower().removesuffix(".gz").endswith(self.suffixes)


def _lazy(function: str) -> Callable[..., Any]:
    """Return a function of `shapefit.io`, whose module is imported when it is called."""
    module, _, name = function.rpartition(".")

    def call(*given: Any, **how: Any) -> Any:
        return getattr(import_module(f"shapefit.io.{module}"), name)(*given, **how)

    return call


IMAGES, SHAPES, EITHER = ("landmarks",), ("shapes",), ("landmarks", "shapes")
ANY = ("landmarks", "shapes", "result")

HDF5 = FileFormat(
    "an HDF5 file",
    (".h5", ".hdf5", ".hdf", ".he5"),
    (*ANY, "dictionary"),
    lambda head: head.bytes.startswith(HDF5_SIGNATURE),
    holds=_lazy("hdf5_records.hdf5_kind"),
    write=_lazy("hdf5_writer.hdf5_output"),
    writes=(*ANY, "dictionary"),
    points_only=False,
)

CSV = FileFormat(
    "a CSV file",
    (".csv",),
    ANY,
    lambda head: {"item", "landmark"} <= head.columns and not HDF5.has_suffix(head.path),
    read_records=_lazy("csv_file.read_csv"),
    holds=_lazy("csv_file.csv_kind"),
    write=_lazy("csv_file.csv_output"),
    writes=ANY,
    states_y_axis=False,
)

# fmt: off
FORMATS: dict[str, FileFormat] = {
    "hdf5": HDF5,
    "csv": CSV,
    "deeplabcut-csv": FileFormat(
        "a DeepLabCut or Lightning Pose CSV", (".csv",), EITHER, detect.is_deeplabcut_csv,
        _lazy("readers.deeplabcut.read_csv"),
    ),
    "deeplabcut-h5": FileFormat(
        "a DeepLabCut HDF5 file", (".h5", ".hdf5"), EITHER, detect.is_pandas,
        _lazy("readers.deeplabcut.read_hdf5"),
    ),
    "jabs-h5": FileFormat(
        "a JABS pose file", (".h5",), IMAGES, has_hdf5("poseest/points"),
        _lazy("readers.trackers.read_jabs"),
    ),
    "movement-netcdf": FileFormat(
        "a movement netCDF file", (".nc", ".nc4"), EITHER, has_hdf5("@ds_type"),
        _lazy("readers.trackers.read_movement"),
    ),
    "nwb-ndx-pose": FileFormat(
        "an NWB file", (".nwb",), EITHER, detect.is_nwb, _lazy("readers.trackers.read_nwb"),
    ),
    "sleap-analysis-h5": FileFormat(
        "a SLEAP analysis file", (".h5", ".hdf5"), IMAGES, has_hdf5("tracks", "node_names"),
        _lazy("readers.sleap.read_analysis"),
    ),
    "sleap-slp": FileFormat(
        "a SLEAP .slp file", (".slp",), IMAGES,
        has_hdf5("metadata@format_id", "frames", "instances"), _lazy("readers.sleap.read_labels"),
    ),
    "alphapose-json": FileFormat(
        "an AlphaPose file of all images", (".json",), IMAGES, detect.is_alphapose,
        _lazy("readers.detections.read_alphapose"),
    ),
    "caliscope-csv": FileFormat(
        "a caliscope CSV", (".csv",), IMAGES, detect.is_caliscope,
        _lazy("readers.tables.read_caliscope"),
    ),
    "coco-annotations": FileFormat(
        "a file of COCO annotations", (".json",), IMAGES, detect.is_coco_annotations,
        _lazy("readers.detections.read_coco_annotations"),
    ),
    "coco-results": FileFormat(
        "a file of COCO results", (".json",), IMAGES, detect.is_coco_results,
        _lazy("readers.detections.read_coco_results"),
    ),
    "mmpose-images": FileFormat(
        "a set of MMPose files", (".json",), IMAGES, in_folder(".json", detect.is_mmpose_images),
        _lazy("readers.detections.read_mmpose_images"), together=True, folders=True,
    ),
    "mmpose-video": FileFormat(
        "an MMPose file", (".json",), IMAGES, detect.is_mmpose_video,
        _lazy("readers.detections.read_mmpose_video"),
    ),
    "openpose": FileFormat(
        "a set of OpenPose files", (".json",), IMAGES, in_folder(".json", detect.is_openpose),
        _lazy("readers.detections.read_openpose"), together=True, folders=True,
    ),
    "ultralytics-txt": FileFormat(
        "a set of YOLO pose labels", (".txt",), IMAGES, in_folder(".txt", detect.is_yolo),
        _lazy("readers.yolo.read_yolo"), together=True, folders=True,
    ),
    "acclaim": FileFormat(
        "an ASF/AMC motion", (".amc", ".asf"), SHAPES, detect.is_acclaim,
        _lazy("readers.motion.read_acclaim"), together=True,
    ),
    "anipose-csv": FileFormat(
        "an anipose 3D CSV", (".csv",), SHAPES, detect.is_anipose,
        _lazy("readers.markers.read_anipose"),
    ),
    "bvh": FileFormat(
        "a BVH motion", (".bvh",), SHAPES, detect.is_bvh, _lazy("readers.motion.read_bvh"),
    ),
    "c3d": FileFormat(
        "a C3D file", (".c3d",), SHAPES, detect.is_c3d, _lazy("readers.motion.read_c3d"),
    ),
    "trc": FileFormat(
        "a TRC file", (".trc",), SHAPES, detect.is_trc, _lazy("readers.markers.read_trc"),
    ),
    "vicon-csv": FileFormat(
        "a Vicon Nexus CSV of trajectories", (".csv",), SHAPES, detect.is_vicon,
        _lazy("readers.motion.read_vicon"),
    ),
    "table": FileFormat(
        "a table of landmarks", (".csv", ".tsv", ".txt"), EITHER, detect.is_table,
        _lazy("readers.tables.read_any_table"), states_y_axis=False,
    ),
    "arrays": FileFormat(
        "an array of landmarks", (".npy", ".npz"), IMAGES, detect.is_array,
        _lazy("readers.arrays.read_array"), states_y_axis=False,
    ),
    "named-points": FileFormat(
        "JSON of points by frame and landmark", (".json",), IMAGES, detect.is_named_points,
        _lazy("readers.detections.read_named_points"),
    ),
    "mediapipe": FileFormat(
        "a file of MediaPipe's landmarks", (".json",), IMAGES, detect.is_mediapipe,
        _lazy("readers.detections.read_mediapipe"),
    ),
}
# fmt: on
"""Those of the package come first; the others are asked before them, in this order."""


def detect_format(path: Path, name: str = "auto") -> FileFormat:
    """Return the format of a file or folder, by what it begins with; text of no known kind is CSV.

    Standard input and pipes are CSV. With another `name` than auto it is that format. Raises
    InputError as `require_file` does, for unknown names, and for files that are something else.
    """
    if is_stream(path):
        return CSV
    if name != "auto":
        known = named_format(name, FORMATS)
        if path.is_dir() and not known.folders:
            found = f"it is a folder, and {known.title} is a file"
            raise input_error(path, found, f"name the files in it: '{path}/*{known.suffixes[0]}'")
        return known
    if path.is_dir():
        return _detect_folder(Head(path))
    require_file(path)
    if not path.is_file():
        return CSV
    head = Head(path)
    for known in _likely_first(path):
        if known.recognise(head):
            return known
    if HDF5.has_suffix(path) and not path.name.endswith(".gz"):
        fix = "give an HDF5 file, or name it .csv if it is CSV"
        raise input_error(path, "is not an HDF5 file", fix)
    detect.refuse_unknown(head)
    return CSV


def named_format(name: str, known: Mapping[str, FileFormat], key: str = "format") -> FileFormat:
    """Return the format of a name. Raises InputError at the key for unknown ones."""
    if name not in known:
        near = get_close_matches(name, known, n=1, cutoff=0.4)
        fix = f"did you mean {near[0]}?" if near else f"use auto, {listed(known)}"
        raise input_error(key, f"there is no format {name!r}", fix)
    return known[name]


def _detect_folder(head: Head) -> FileFormat:
    """Return the format of a folder whose files are one recording."""
    folders = [known for known in FORMATS.values() if known.folders]
    for known in folders:
        if known.recognise(head):
            return known
    path = head.path
    looked = f", and holds none of these: {listed(known.title for known in folders)}"
    inner = sorted(str(each) for each in path.iterdir() if each.is_dir())
    fix = f"name the files in it, e.g. '{path}/*.h5'"
    fix = f"name the folders in it: {abbreviate(inner, 3)}" if inner else fix
    raise input_error(path, f"it is a folder{looked}", fix)


def _likely_first(path: Path) -> Iterator[FileFormat]:
    """Yield the formats whose names fit before the others, and each time the package's own last.

    Many formats are HDF5 or CSV inside, so they are asked before ours.
    """
    others = [known for known in FORMATS.values() if known not in (HDF5, CSV)]
    ordered = [*others, HDF5, CSV]
    yield from (known for known in ordered if known.has_suffix(path))
    yield from (known for known in ordered if not known.has_suffix(path))


def group_inputs(
    paths: Sequence[Path], options: InputOptions
) -> list[tuple[FileFormat, tuple[Path, ...]]]:
    """Return the inputs in order, each with its format; files that are one recording together."""
    groups: dict[tuple[str, str], tuple[FileFormat, list[Path]]] = {}
    formats = on_threads(partial(detect_format, name=options.format), paths)
    for path, known in zip(paths, formats, strict=True):
        shared = known.together and not path.is_dir()
        key = (known.title, str(path.parent)) if shared else ("", str(path))
        groups.setdefault(key, (known, []))[1].append(path)
    return [(known, tuple(own)) for known, own in groups.values()]


def mixture(groups: Sequence[tuple[FileFormat, tuple[Path, ...]]]) -> tuple[str, ...]:
    """Warn of inputs in several formats, some of them of other tools, whose names may not agree."""
    counts = Counter(known.title for known, _ in groups)
    if len(counts) < 2 or all(known.read_poses is None for known, _ in groups):
        return ()
    found = listed((f"{title} ({number})" for title, number in counts.items()), "and")
    return (f"several formats in one call: {found}; landmarks are matched by their names",)


def check_holds(path: Path, kind: str, known: FileFormat) -> None:
    """Raise InputError where a file of this format cannot hold records of a kind."""
    if kind not in known.records or known.read_poses is not None:
        able = [each for each in FORMATS.values() if kind in each.records and not each.read_poses]
        found = f"is {known.title}, not {listed(each.title for each in able)}"
        found = found if path.is_file() else "is not a file on a disk"
        raise input_error(source_name(path), found, f"give a shapefit-{kind} file")


# Writing.

# fmt: off
_METRES: Any = {"writes": ("shapes", "result"), "in_metres": True}

WRITTEN: dict[str, FileFormat] = {
    "bvh": FileFormat("a BVH file", (".bvh",), write=_lazy("writers.bones.bvh_output"), **_METRES),
    "c3d": FileFormat(
        "a C3D file", (".c3d",), write=_lazy("writers.markers.c3d_output"), **_METRES,
    ),
    "trc": FileFormat(
        "a TRC file", (".trc",), angles=True, write=_lazy("writers.markers.trc_output"), **_METRES,
    ),
    "mot": FileFormat(
        "a MOT file", (".mot",), angles=True, write=_lazy("writers.tables.mot_output"), **_METRES,
    ),
    "metres": FileFormat(
        "a table in metres", (".metres.csv",), write=_lazy("writers.tables.metres_output"),
        **_METRES,
    ),
    "angles": FileFormat(
        "a table of joint angles", (".angles.csv",), angles=True,
        write=_lazy("writers.tables.angles_output"), **_METRES,
    ),
}
# fmt: on
"""Formats that are written for other tools; those of them that can be read have a row above."""


def targets() -> dict[str, FileFormat]:
    """Return the formats that can be written, by their names."""
    return {name: known for name, known in FORMATS.items() if known.write} | WRITTEN


def landmark_writer(target: Path) -> AbstractContextManager[RecordWriter[LandmarkSet]]:
    """Give a writer of landmarks for use in a `with`; `append` takes chunk after chunk.

    A name that ends in .csv and `-` (standard output) give CSV,
    one in .h5 or without an ending HDF5. The file replaces `target` on a clean exit and leaves
    nothing behind on an error. At least one record must be appended; it may be empty. Raises
    InputError where the target cannot be written.
    """
    return record_writer(target, LANDMARKS)


def result_writer(
    target: Path, options: OutputOptions = AS_KNOWN
) -> AbstractContextManager[RecordWriter[ResultSet]]:
    """Write results, as `landmark_writer` writes landmarks."""
    return record_writer(target, RESULTS, options=options)


def record_writer(
    target: Path, form: Layout, to: str = "auto", options: OutputOptions = AS_KNOWN
) -> AbstractContextManager[RecordWriter[Any]]:
    """Write records of one layout, in the format `to`, or in that of the target's name.

    Raises InputError where that format cannot hold them, for all but CSV on standard output, and
    for options that are for files in metres where it is none.
    """
    known = check_target_format(target, form.kind, to)
    if is_stream(target) and known is not CSV:
        found = "files of this format cannot go to standard output"
        raise input_error("output", found, "name a file")
    if options.given and not known.in_metres:
        found = f"{known.title} keeps the unit and the axes of what is written"
        raise input_error(
            options.given[0], found, "leave it out, or end the name in .metres.csv, .trc or .c3d"
        )
    further = (options,) if known.in_metres else ()
    assert known.write is not None
    return known.write(target, form, *further)


def find_target_format(path: Path, name: str = "auto") -> FileFormat:
    """Return the format that an output path asks for: CSV for `-`, HDF5 for a name without ending.

    With another `name` than auto it is that format. Raises InputError for an ending of no format.
    """
    if name != "auto":
        return named_format(name, targets(), "to")
    if is_stream(path):
        return CSV
    endings = {suffix: known for known in targets().values() for suffix in known.suffixes}
    if named := [suffix for suffix in endings if path.name.lower().endswith(suffix)]:
        return endings[max(named, key=len)]
    if path.suffix:
        found = f"no format that is written ends in {path.suffix}"
        raise input_error(path, found, f"end the name in {listed(endings)}")
    return HDF5


def check_target_format(path: Path, kind: str, name: str = "auto") -> FileFormat:
    """Return the format of an output. Raises InputError where it cannot hold records of a kind."""
    known = find_target_format(path, name)
    if kind in known.writes:
        return known
    name = known.title.split()[1]
    if kind == "landmarks" and known.in_metres:
        fix = "lift them with `shapefit fit` first, or write .h5 or .csv"
        raise input_error(path, f"2D landmarks cannot be {name}", fix)
    raise input_error(path, f"a {kind} cannot be {name}", "give it a name in .h5")
