"""The commands that run a pipeline on a config: one table."""

from __future__ import annotations

from dataclasses import dataclass

import click

from .options import DICTIONARY, Key, key


@dataclass(frozen=True)
class Spec:
    """A command: its texts, its pipeline, and the options that are keys of its config.

    inputs       the argument, a key of the config, and how the usage shows it
    required     keys without which the command does nothing
    in_parts     the pipeline where the output is a folder of results
    unit         what the progress bar counts
    prints_note  the last note of the pipeline is the result of the command, for stdout
    """

    name: str
    pipeline: str
    unit: str
    summary: str
    text: str
    examples: tuple[str, ...]
    inputs: tuple[str, str]
    options: tuple[Key, ...]
    required: tuple[str, ...] = ()
    in_parts: str = ""
    prints_note: bool = False


class Size(click.ParamType[object]):
    """A width and a height, such as 1920x1080."""

    name = "size"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> object:
        """Return [width, height]; fail for other texts."""
        try:
            width, height = (float(part) for part in str(value).lower().split("x"))
        except ValueError:
            self.fail(f"{value!r} is no size; give WIDTHxHEIGHT, such as 1920x1080", param, ctx)
        return [width, height]


class NumberOrWord(click.ParamType[object]):
    """A number, or a word such as auto."""

    name = "number"

    def convert(
        self, value: object, _param: click.Parameter | None, _ctx: click.Context | None
    ) -> object:
        """Return a float where the text is one; the config judges words."""
        try:
            return float(str(value))
        except ValueError:
            return value


OUTPUT = "-o --output"
PEOPLE = "Dictionary file, or the name of an installed one (default: people)."
RATE = key("--frame-rate", "Frames per second, if the files do not state it.", "HZ", float)
HEIGHT = key("--height", "Height of the person in metres.", "METRES", float)
KEYPOINTS = key("--keypoints", "Skeleton of files without names: body_25, coco_17 ...", "NAME")
INDIVIDUAL = key("--individual", "Read only this individual.", "NAME")
CONFIDENCE = key("--min-confidence", "Hide less confident landmarks.", "NUMBER", float)
SIZE = key("--image-size", "Size of the images in pixels, such as 1920x1080.", "WxH", Size())
EVERY = key("--every", "Take every n-th frame.", "N", int)
MARKERS = key("--markers", "TRC markers: joints, or input (detector names).", "WHICH")
TRUTH = key("--truth", "File of the true 3D shapes. Repeatable.", "SHAPES", multiple=True)
SEED = key("--seed", "Seed of random choices.", "N", int)

COMMANDS = (
    Spec(
        "learn-dict",
        pipeline="learn_dict.run",
        unit="round",
        summary="Learn a dictionary from 3D shapes, or from 2D landmarks alone.",
        text="""Learn a dictionary of rotatable basis shapes from 3D shapes, or from 2D landmarks.

SHAPES are files of 3D shapes, or of 2D landmarks seen from different sides (docs/from_2d.md), in
any format that can be read (docs/formats.md). Globs work.""",
        examples=(
            "shapefit learn-dict train.h5 -o dict.h5",
            "shapefit learn-dict 'train/*.h5' -o dict.h5 --every 3 --set k=128",
            "shapefit learn-dict models.h5 -o cars.h5 --method exemplars",
            "shapefit learn-dict tracked.csv -o animal.h5",
        ),
        inputs=("shapes", "SHAPES..."),
        required=("shapes",),
        options=(
            key(OUTPUT, "Dictionary file to write (HDF5).", "DICT.h5"),
            key("--method", "sparse-coding, exemplars or pca-bases.", "NAME"),
            EVERY,
            KEYPOINTS,
            INDIVIDUAL,
            CONFIDENCE,
        ),
    ),
    Spec(
        "project",
        pipeline="projection",
        unit="image",
        summary="Project 3D shapes to synthetic 2D landmarks.",
        text="""Project 3D shapes to synthetic 2D landmarks with a known camera.

SHAPES are files of 3D shapes in any format that can be read (docs/formats.md). Globs work, - is
stdin (CSV).""",
        examples=(
            "shapefit project test.h5 -o views.h5",
            "shapefit project test.h5 -o views.h5 --noise 0.01 --set hidden=0.2",
            "shapefit project test.h5 -o - --set camera.view=random > views.csv",
        ),
        inputs=("shapes", "SHAPES..."),
        required=("shapes",),
        options=(
            key(OUTPUT, "Landmark file to write; - is stdout (CSV).", "LANDMARKS"),
            key("--noise", "Standard deviation of noise on each coordinate.", "NUMBER", float),
            SEED,
        ),
    ),
    Spec(
        "fit",
        pipeline="fit.run",
        in_parts="partition.run",
        unit="image",
        summary="Lift 2D landmarks to 3D shapes.",
        text="""Lift 2D landmarks in single images or videos to 3D shapes.

LANDMARKS are files of 2D landmarks in any format that can be read, or folders with one file per
frame (docs/formats.md). Globs work, - is stdin (CSV).""",
        examples=(
            "shapefit fit cam01_json/",
            "shapefit fit cam01_json/ -o man.trc --image-size 1920x1080 --height 1.78",
            "shapefit fit views.h5 -d dict.h5 -o result.h5 --method convex --lambda 0.2",
            "shapefit fit 'day1/*.h5' -d dict.h5 -o results/ --workers 4",
            "shapefit fit -d dict.h5 -o - - < landmarks.csv > shapes.csv",
        ),
        inputs=("landmarks", "LANDMARKS..."),
        required=("landmarks",),
        options=(
            key(OUTPUT, "Result file; - is stdout (CSV), FOLDER/ one file per part.", "RESULT"),
            key("-d --dictionary", PEOPLE, "DICT", DICTIONARY),
            key("--method", "sequences, posterior, convex, ... (default: by dictionary).", "NAME"),
            KEYPOINTS,
            INDIVIDUAL,
            CONFIDENCE,
            RATE,
            SIZE,
            key("--focal", "Focal length in pixels; none is weak perspective.", "NUMBER",
                NumberOrWord(), to="camera.focal"),
            key("--calibration", "Calibration file of the cameras.", "FILE",
                to="camera.calibration"),
            key("--camera", "Camera of the calibration that took the images.", "NAME",
                to="camera.name"),
            HEIGHT,
            MARKERS,
            key("--lambda", "Weight of the norms, or auto.", "NUMBER", NumberOrWord()),
            key("--noise", "Standard deviation of a landmark in pixels.", "NUMBER", float),
            key("--workers", "Do the parts with N processes.", "N", int),
            key("--scheduler", "Do the parts on a running Dask cluster.", "ADDRESS"),
            key("--scheduler-file", "The same, by the file of the scheduler.", "FILE"),
            key("--dry-run", "Only list the parts to do.", None),
            key("--replace", "Replace other results in the folder.", None),
            key("--fail-untrusted", "Exit with 1 if more than this share (0 to 1) of the images "
                "is not to be trusted.", "SHARE", click.FloatRange(0, 1)),
        ),
    ),
    Spec(
        "eval",
        pipeline="evaluate.run",
        unit="image",
        summary="Compare results with the truth.",
        text="""Compare results with the truth; print the errors to stdout.

RESULTs are files that fit wrote; globs work. In the report each has the name of its file; the
config can set other names.""",
        examples=(
            "shapefit eval result.h5 --truth test.h5 -o report/",
            "shapefit eval convex.h5 pmp.h5 --truth 'test/*.h5' -o report/ > errors.txt",
        ),
        inputs=("results", "RESULT..."),
        required=("results", "truth"),
        options=(
            key(OUTPUT, "Folder to write the report to.", "DIR"),
            TRUTH,
            key("--match", "item, frame, or a dataset that names the true shape.", "NAME"),
        ),
        prints_note=True,
    ),
    Spec(
        "convert",
        pipeline="convert",
        unit="item",
        summary="Write landmarks, shapes or results in another format.",
        text="""Write landmarks, shapes or results in another format, or meshes of a result.

INPUTs are files of any format that can be read, or folders with one file per frame
(docs/formats.md). The format of the output follows from its name, or --to.""",
        examples=(
            "shapefit convert mouseDLC.csv -o mouse.h5",
            "shapefit convert cam01_json/ -o man.h5 --keypoints body_25b",
            "shapefit convert labels.slp -o - --individual mouse1 > mouse1.csv",
            "shapefit convert result.h5 -d cars.h5 -o meshes/ --to ply",
        ),
        inputs=("files", "INPUT..."),
        required=("files", "output"),
        options=(
            key(OUTPUT, "File to write; - is stdout (CSV).", "OUTPUT"),
            key("--to", "Format to write, such as csv or ply.", "FORMAT"),
            key("-d --dictionary", "Dictionary with the meshes.", "DICT", DICTIONARY),
            KEYPOINTS,
            INDIVIDUAL,
            CONFIDENCE,
            EVERY,
            RATE,
            SIZE,
            HEIGHT,
            MARKERS,
        ),
    ),
    Spec(
        "info",
        pipeline="info",
        unit="file",
        summary="Describe files and print the next command.",
        text="""Describe files and print the next command; without files, list what is installed.

FILEs are of any format that can be read, or folders with one file per frame.""",
        examples=("shapefit info", "shapefit info mouseDLC.h5", "shapefit info cam01_json/"),
        inputs=("files", "[FILE]..."),
        options=(KEYPOINTS, key("--format", "Format of the files.", "FORMAT")),
        prints_note=True,
    ),
    Spec(
        "view",
        pipeline="view.run",
        unit="frame",
        summary="Show results on a page to rotate and play.",
        text="""Write one HTML page that shows results, to rotate and play, or a sheet of pictures.

The page needs no network and no server: send it to a colleague. On the left are the landmarks in
the image, on the right the shapes in 3D, and below them a strip that shows where to look.""",
        examples=(
            "shapefit view result.h5",
            "shapefit view convex.h5 pmp.h5 --truth test.h5 -o page.html --open",
            "shapefit view cars.h5 --truth models.h5 --match true_model --images frames/",
        ),
        inputs=("files", "FILE..."),
        required=("files",),
        options=(
            key(OUTPUT, "HTML file to write, or PNG or SVG.", "PAGE.html"),
            TRUTH,
            key("--match", "item, frame, or a dataset that names the true shape.", "NAME"),
            key("-d --dictionary", "Dictionary with edges and meshes to draw.", "DICT", DICTIONARY),
            key("--images", "Images under the landmarks.", "FOLDER"),
            KEYPOINTS,
            RATE,
            key("--open", "Open the page in a browser.", None, to="opens"),
        ),
    ),
)  # fmt: skip
"""In the order of the help, which is that of the chain."""
