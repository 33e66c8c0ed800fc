"""The commands that run a pipeline on a config: one table."""

from __future__ import annotations

from dataclasses import dataclass

import click

from .options import DICTIONARY, option


@dataclass(frozen=True)
class Spec:
    """A command: its texts, its pipeline, and the arguments that are keys of its config.

    `in_parts` is the pipeline where the output is a folder of results; `unit` is what the progress
    bar counts. Where `prints_note` the last note of the pipeline is the result of the command, for
    stdout.
    """

    name: str
    pipeline: str
    unit: str
    summary: str
    text: str
    examples: str
    parameters: tuple[click.Parameter, ...]
    in_parts: str = ""
    prints_note: bool = False


def _files(key: str, metavar: str | None = None) -> click.Argument:
    return click.Argument([key], nargs=-1, metavar=metavar)


_TRUTH = "File of the true 3D shapes. Repeatable."
_OF_A_FIT = "Dictionary that learn-dict wrote, or the name of an installed one, such as people."
_UNTRUSTED = "Exit with 1 if more than this share of images, 0 to 1, is not to be trusted."
_MARKERS = option(
    "--markers",
    "In files in metres: joints, or input, the landmarks of the detector by their own names.",
    "WHICH",
    type=click.Choice(["joints", "input"]),
)
_DRAWN = "Dictionary with the edges and meshes to draw."

COMMANDS = (
    Spec(
        "learn-dict",
        pipeline="learn_dict.run",
        unit="round",
        summary="Learn a dictionary from 3D shapes, or from 2D landmarks alone.",
        text="""Learn a dictionary of rotatable basis shapes from 3D shapes, or from 2D landmarks.

SHAPES are files of 3D shapes, or of 2D landmarks seen from different sides (docs/from_2d.md), in
any format that can be read; docs/formats.md lists them. Globs work.""",
        examples="""\
  shapefit learn-dict train.h5 -o dict.h5
  shapefit learn-dict -c learn-dict.yaml 'train/*.h5' -o dict.h5 --set k=128
  shapefit learn-dict -c cars models.h5 -o cars.h5
  shapefit learn-dict tracked.csv -o animal.h5
  shapefit learn-dict train.csv -o dict.h5 --set beta=0.05 --print-config""",
        parameters=(
            _files("shapes"),
            option("-o --output", "Dictionary file to write (HDF5).", "DICT.h5"),
        ),
    ),
    Spec(
        "project",
        pipeline="projection",
        unit="image",
        summary="Project 3D shapes to synthetic 2D landmarks.",
        text="""Project 3D shapes to synthetic 2D landmarks with a known camera.

SHAPES are files of 3D shapes in any format that can be read; docs/formats.md lists them. Globs
work, - is stdin (CSV).""",
        examples="""\
  shapefit project test.h5 -o views.h5
  shapefit project -c project.yaml test.h5 -o views.h5 --set noise=0.01 --set hidden=0.2
  shapefit project test.h5 -o - --set camera.view=random > views.csv""",
        parameters=(
            _files("shapes"),
            option("-o --output", "Landmark file to write; - is stdout (CSV).", "LANDMARKS"),
        ),
    ),
    Spec(
        "fit",
        pipeline="fit.run",
        in_parts="partition.run",
        unit="image",
        summary="Lift 2D landmarks to 3D shapes.",
        text="""Lift 2D landmarks in single images to 3D shapes.

LANDMARKS are files of 2D landmarks in any format that can be read, or folders with one file per
frame; docs/formats.md lists them. Globs work, - is stdin (CSV). Files may be URLs of an object
store (s3://, gs://).""",
        examples="""\
  shapefit fit views.h5 -d dict.h5 -o result.h5
  shapefit fit -c fit.yaml 'views/*.h5' -d dict.h5 -o result.h5 --set lambda=0.2
  shapefit fit cam01_json/ -d people -o man.trc --set keypoints=body_25
  shapefit fit -c cars photos.h5 -d cars.h5 -o result.h5
  shapefit fit -d dict.h5 -o - - < landmarks.csv > shapes.csv""",
        parameters=(
            _files("landmarks"),
            option(
                "-o --output", "Result file; - is stdout (CSV), FOLDER/ a file per part.", "RESULT"
            ),
            option("-d --dictionary", _OF_A_FIT, "DICT.h5", type=DICTIONARY),
            option("--workers", "Do the parts with N processes.", "N", type=int),
            option("--scheduler", "Do the parts on a running Dask cluster.", "ADDRESS"),
            option("--scheduler-file", "The same, by the file of the scheduler.", "FILE"),
            option("--dry-run", "Only list the parts to do.", default=None),
            option("--replace", "Replace other results in the folder.", default=None),
            option("--fail-untrusted", _UNTRUSTED, "SHARE", type=click.FloatRange(0, 1)),
            _MARKERS,
        ),
    ),
    Spec(
        "eval",
        pipeline="evaluate.run",
        unit="image",
        summary="Compare results with the truth.",
        text="""Compare results with the truth; print the table of errors (Markdown) to stdout.

RESULTs are files that fit wrote; globs work. In the table each has the name of its file; the
config can set other names.""",
        examples="""\
  shapefit eval result.h5 --truth test.h5 -o report/
  shapefit eval -c eval.yaml convex.h5 pmp.h5 --truth test.h5 -o report/
  shapefit eval result.h5 --truth 'test/*.h5' -o report/ > table.md""",
        parameters=(
            _files("results", "[RESULT]..."),
            option("-o --output", "Folder to write the report to.", "DIR"),
            option("--truth", _TRUTH, "SHAPES", multiple=True),
        ),
        prints_note=True,
    ),
    Spec(
        "convert",
        pipeline="convert",
        unit="item",
        summary="Write landmarks, shapes or results in another format.",
        text="""Write landmarks, shapes or results in another format.

INPUTs are files of any format that can be read, or folders with one file per frame; docs/formats.md
lists them. The format of the output follows from its name, or --to.""",
        examples="""\
  shapefit convert mouseDLC.csv -o mouse.h5
  shapefit convert cam01_json/ -o man.h5 --set keypoints=body_25b --set track=nearest
  shapefit convert labels.slp -o - --set individual=mouse1 > mouse1.csv
  shapefit convert walk.c3d -o walk.h5""",
        parameters=(
            _files("files", "INPUT..."),
            option("-o --output", "File to write; - is stdout (CSV).", "OUTPUT"),
            option("--to", "Format to write, such as trc or csv.", "FORMAT"),
            _MARKERS,
        ),
    ),
    Spec(
        "info",
        pipeline="info",
        unit="file",
        summary="Tell what files hold, and how to go on.",
        text="""Tell what files hold, and the command to go on with.

FILEs are of any format that can be read, or folders with one file per frame.""",
        examples="""\
  shapefit info mouseDLC.h5
  shapefit info cam01_json/ result.h5
  shapefit info people""",
        parameters=(_files("files", "FILE..."),),
        prints_note=True,
    ),
    Spec(
        "view",
        pipeline="view.run",
        unit="frame",
        summary="Show results on a page to rotate and play.",
        text="""Write one HTML page that shows results, to rotate and play.

The page needs no network and no server: send it to a colleague. On the left are the
landmarks in the image, on the right the shapes in 3D, and below them a strip that shows where
to look.""",
        examples="""\
  shapefit view result.h5
  shapefit view convex.h5 pmp.h5 --truth test.h5 -o page.html --open
  shapefit view cars.h5 --truth models.h5 --set match=true_model --images frames/""",
        parameters=(
            _files("files", "[RESULT|LANDMARKS|SHAPES]..."),
            option("-o --output", "HTML file to write.", "PAGE.html"),
            option("--truth", _TRUTH, "SHAPES", multiple=True),
            option("-d --dictionary", _DRAWN, "DICT.h5", type=DICTIONARY),
            option("--images", "Images under the landmarks.", "FOLDER"),
            option("--open opens", "Open the page in a browser."),
        ),
    ),
)
"""In the order of the help, which is that of the chain."""
