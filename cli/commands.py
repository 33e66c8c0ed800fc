"""The commands, a function each: its options, its help, the pipeline that it runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from shapefit.errors import as_typed

from .call import Call
from .options import (
    as_json,
    command,
    dictionary,
    end_of_help,
    every,
    frame_rate,
    keypoints,
    metres,
    of_config,
    of_report,
    output,
    reading,
    truth,
)
from .values import (
    FILE,
    INPUT_FORMAT,
    NUMBER_OR_WORD,
    OUTPUT_FORMAT,
    SECTION,
    TEXT,
    WORD,
)

if TYPE_CHECKING:
    from shapefit.config import CommandConfig, FitConfig
    from shapefit.config.reference import KeyInWords

MAX_NAMED = 3
"""Input files that a line names; others are counted."""


@command(
    "learn-dict",
    "shapefit learn-dict train.h5 -o dict.h5 --prior",
    "shapefit learn-dict 'train/*.h5' -o dict.h5 --every 3 --set k=128",
    "shapefit learn-dict tracked.csv -o animal.h5",
    needs=["shapes"],
)
@click.argument("shapes", nargs=-1, type=FILE, metavar="SHAPES...")
@output("DICT.h5", "Dictionary file to write (HDF5).")
@click.option(
    "--method",
    type=WORD,
    metavar="NAME",
    help="sparse-coding, exemplars or pca-bases.",
)
@every
@click.option(
    "--prior",
    "prior__components",
    flag_value="auto",
    default=None,
    help="Learn a prior over shapes too, so that a fit has error bars.",
)
@reading
@of_config
@of_report
def learn_dict(call: Call, **keys: object) -> int:
    """Learn a dictionary of rotatable shapes from 3D shapes, or from 2D landmarks.

    SHAPES are files of 3D shapes, or of 2D landmarks seen from different sides
    (docs/from_2d.md), in any format that can be read (docs/formats.md). Globs work.
    """
    from shapefit.config import LearnDictConfig

    config = call.read_config(LearnDictConfig, keys)
    from shapefit.pipelines.learn_dict.run import learn_dictionary

    return call.follow(
        learn_dictionary(config),
        "round",
        read=name_inputs(config, "shapes"),
        next_command=fit_command(config.output, "LANDMARKS -d {} -o result.h5"),
    )


@command(
    "project",
    "shapefit project test.h5 -o views.h5",
    "shapefit project test.h5 -o - --set camera.view=random > views.csv",
    needs=["shapes"],
)
@click.argument("shapes", nargs=-1, type=FILE, metavar="SHAPES...")
@output("LANDMARKS", "Landmark file to write; - is stdout (CSV).")
@click.option(
    "--noise",
    type=float,
    metavar="NUMBER",
    help="Standard deviation of noise on each coordinate.",
)
@click.option("--seed", type=int, metavar="N", help="Seed of random choices.")
@of_config
@of_report
def project(call: Call, **keys: object) -> int:
    """Project 3D shapes to synthetic 2D landmarks with a known camera.

    SHAPES are files of 3D shapes in any format that can be read (docs/formats.md).
    Globs work, - is stdin (CSV).
    """
    from shapefit.config import ProjectConfig

    config = call.read_config(ProjectConfig, keys)
    from shapefit.pipelines.projection import project_shapes

    return call.follow(
        project_shapes(config),
        "image",
        read=name_inputs(config, "shapes"),
        next_command=fit_command(config.output, "{} -d DICT.h5 -o result.h5"),
    )


@command(
    "fit",
    "shapefit fit cam01_json/",
    "shapefit fit cam01_json/ -o man.trc --image-size 1920x1080 --height 1.78",
    "shapefit fit views.h5 -d dict.h5 -o result.h5 --method convex --lambda 0.2",
    "shapefit fit 'day1/*.h5' -d dict.h5 -o results/ --workers 4",
    "shapefit fit -d dict.h5 -o - - < landmarks.csv > shapes.csv",
    "tail -f landmarks.csv | shapefit fit -d dict.h5 -o - - --live",
    needs=["landmarks"],
)
@click.argument("landmarks", nargs=-1, type=FILE, metavar="LANDMARKS...")
@output("RESULT", "Result file; - is stdout (CSV), FOLDER/ one file per part.")
@dictionary("Dictionary: a file, or an installed one (default: people).")
@click.option(
    "--method",
    type=WORD,
    metavar="METHOD",
    help="sequences, posterior, convex, ... (default: by dictionary).",
)
@reading
@click.option(
    "--frames",
    type=TEXT,
    metavar="FIRST:STOP",
    help="Lift only these frames, such as 100:400 (400 is left out).",
)
@every
@metres
@click.option(
    "--focal",
    "camera__focal",
    type=NUMBER_OR_WORD,
    metavar="FOCAL",
    help="Focal length in pixels; none is weak perspective.",
)
@click.option(
    "--calibration",
    "camera__calibration",
    type=FILE,
    metavar="FILE",
    help="Calibration file of the cameras.",
)
@click.option(
    "--camera",
    "camera__name",
    metavar="NAME",
    help="Camera of the calibration that took the images.",
)
@click.option(
    "--lambda",
    type=NUMBER_OR_WORD,
    metavar="LAMBDA",
    help="Weight of the norms, or auto.",
)
@click.option(
    "--noise",
    type=float,
    metavar="NUMBER",
    help="Standard deviation of a landmark in pixels.",
)
@click.option(
    "--partition",
    type=click.IntRange(min=1),
    metavar="COUNT",
    help="Images of a part of a folder (default: 100,000).",
)
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    metavar="COUNT",
    help="Fit the parts with this many processes.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Fit the parts on a running Dask cluster.",
)
@click.option(
    "--scheduler-file",
    type=click.Path(exists=True, dir_okay=False, resolve_path=True, path_type=Path),
    metavar="SCHEDULER.json",
    help="The same, by the file of the scheduler.",
)
@click.option(
    "--replace",
    "replace_others",
    is_flag=True,
    default=None,
    help="Replace other results in the folder.",
)
@click.option(
    "--fail-untrusted",
    type=click.FloatRange(0, 1),
    metavar="SHARE",
    help="Exit with 1 if more of the images than this are not trusted.",
)
@click.option(
    "--live",
    is_flag=True,
    help="Write the rows of an item as soon as it is complete; from - to -.",
)
@of_config
@of_report
def fit(
    call: Call,
    live: bool,
    partition: int | None,
    workers: int | None,
    scheduler: str | None,
    scheduler_file: Path | None,
    replace_others: bool | None,
    fail_untrusted: float | None,
    **keys: object,
) -> int:
    """Lift 2D landmarks in single images or videos to 3D shapes.

    LANDMARKS are files of 2D landmarks in any format that can be read, or folders with
    one file per frame (docs/formats.md). Globs work, - is stdin (CSV).
    """
    from shapefit.config import FitConfig

    config = with_parts(
        call.read_config(FitConfig, keys),
        partition=partition,
        workers=workers,
        scheduler=scheduler,
        scheduler_file=scheduler_file,
        replace=replace_others,
    )
    if live:
        from shapefit.pipelines.fit.live import fit_live as run
    elif hasattr(config.output, "manifest"):
        from shapefit.pipelines.partition.run import fit_parts as run
    else:
        from shapefit.pipelines.fit.fit import fit as run
    return call.follow(
        run(config),
        "image",
        read=name_inputs(config, "landmarks"),
        max_untrusted=fail_untrusted,
    )


def with_parts(config: FitConfig, **options: object) -> FitConfig:
    """Return the config with these options, such as `workers`, of its output folder.

    Raises click.UsageError where the output is no folder, and for ways that exclude
    each other.
    """
    given = {name: value for name, value in options.items() if value is not None}
    if len(given.keys() & {"workers", "scheduler", "scheduler_file"}) > 1:
        fault = "--workers, --scheduler and --scheduler-file exclude each other"
        raise click.UsageError(f"{fault}; give one of them")
    if not given:
        return config
    if isinstance(config.output, Path):
        flag = "--" + min(given).replace("_", "-")
        raise click.UsageError(
            f"{flag} needs a folder as output, for example -o results/"
        )
    return config.changed(output=replace(config.output, **given))  # type: ignore[arg-type]


@command(
    "eval",
    "shapefit eval result.h5 --truth test.h5 -o report/",
    "shapefit eval convex.h5 pmp.h5 --truth 'test/*.h5' -o report/ > errors.txt",
    needs=["results", "truth"],
)
@click.argument("results", nargs=-1, type=FILE, metavar="RESULT...")
@output("DIR", "Folder to write the report to.")
@truth
@of_config
@of_report
def evaluate(call: Call, **keys: object) -> int:
    """Compare results with the truth; print the errors to stdout.

    RESULTs are files that fit wrote; globs work. In the report each has the name of its
    file; the config can set other names.
    """
    from shapefit.config import EvalConfig

    config = call.read_config(EvalConfig, keys)
    from shapefit.pipelines.evaluate.run import evaluate_results

    read = name_inputs(config, "results")
    return call.follow(evaluate_results(config), "image", read=read, to_stdout=True)


@command(
    "convert",
    "shapefit convert mouseDLC.csv -o mouse.h5",
    "shapefit convert labels.slp -o - --individual mouse1 > mouse1.csv",
    "shapefit convert result.h5 -d cars.h5 -o meshes/ --to ply",
    needs=["files", "output"],
)
@click.argument("files", nargs=-1, type=FILE, metavar="INPUT...")
@output("OUTPUT", "File to write; - is stdout (CSV).")
@click.option(
    "--to",
    type=OUTPUT_FORMAT,
    metavar="FORMAT",
    help="Format to write, such as csv, trc, obj, ply or glb.",
)
@dictionary("Dictionary with the meshes.")
@reading
@metres
@every
@of_config
@of_report
def convert(call: Call, **keys: object) -> int:
    """Write landmarks, shapes or results in another format, or meshes of a result.

    INPUTs are files of any format that can be read, or folders with one file per frame
    (docs/formats.md). The format of the output follows from its name, or --to.
    """
    from shapefit.config import ConvertConfig

    config = call.read_config(ConvertConfig, keys)
    from shapefit.pipelines.convert import convert_files

    return call.follow(convert_files(config), "item", read=name_inputs(config, "files"))


@command("info", "shapefit info", "shapefit info cam01_json/")
@click.argument("files", nargs=-1, type=FILE, metavar="[FILE]...")
@keypoints
@click.option(
    "--format", type=INPUT_FORMAT, metavar="FORMAT", help="Format of the files."
)
@of_config
@of_report
def info(call: Call, **keys: object) -> int:
    """Describe files and print the next command; without files, list what is installed.

    FILEs are of any format that can be read, or folders with one file per frame.
    """
    from shapefit.config import InfoConfig

    config = call.read_config(InfoConfig, keys)
    from shapefit.pipelines.info import describe_files

    read = name_inputs(config, "files")
    return call.follow(describe_files(config), "file", read=read, to_stdout=True)


@command(
    "view",
    "shapefit view result.h5",
    "shapefit view convex.h5 pmp.h5 --truth test.h5 -o page.html --open",
    "shapefit view cars.h5 --truth models.h5 --match true_model --images frames/",
    needs=["files"],
)
@click.argument("files", nargs=-1, type=FILE, metavar="FILE...")
@output("PAGE.html", "HTML file to write, or PNG or SVG.")
@truth
@dictionary("Dictionary with edges and meshes to draw.")
@click.option(
    "--images",
    type=FILE,
    metavar="FOLDER",
    help="Folder of photographs, or a film, under the landmarks.",
)
@keypoints
@frame_rate
@click.option("--open", "show", is_flag=True, help="Open the page in a browser.")
@of_config
@of_report
def view(call: Call, show: bool, **keys: object) -> int:
    """Write one HTML page that shows results, to rotate and play, or a sheet of
    pictures.

    The page needs no network and no server: send it to a colleague. It shows 3D on the
    left, the image on the right, and below them joint angles and errors over time.
    """
    from shapefit.config import ViewConfig

    config = call.read_config(ViewConfig, keys)
    from shapefit.pipelines.view.run import write_page

    read = name_inputs(config, "files")
    return call.follow(write_page(config), "frame", read=read, show=show)


@command(
    "verify",
    "shapefit verify result.h5 -d dict.h5",
    "shapefit verify result.h5 -d dict.h5 --landmarks views.h5",
    needs=["result", "dictionary"],
)
@click.argument("result", required=False, type=FILE, metavar="RESULT")
@dictionary("Dictionary of the fit: a file, or an installed one.")
@click.option(
    "--landmarks",
    type=FILE,
    multiple=True,
    metavar="FILE",
    help="Landmarks of the fit, to compare with the result's. Repeatable.",
)
@of_report
def verify(call: Call, result: str, dictionary: str, landmarks: Sequence[str]) -> int:
    """Check the certificates in a result without the solver; print a summary to stdout.

    RESULT is an HDF5 file that fit wrote, or a folder of them. For the methods convex
    and convex+refine the certificate of every image is computed again. Digests of all
    that the files hold, datasets and ranges are compared, and with --landmarks the
    landmarks. Images with a false claim count as failed.
    """
    from shapefit.pipelines.verify import Request, verify_results

    path = Path(dictionary)
    if not path.is_file():  # the schemas of configs take long to import
        from shapefit.config.paths import find_dictionaries

        path = find_dictionaries().get(dictionary, path)
    request = Request(Path(result), path, tuple(map(Path, landmarks)))
    return call.follow(verify_results(request), "image", to_stdout=True)


def name_inputs(config: CommandConfig, key: str) -> str:
    """Return the names of the first input files of a key, and the number of others."""
    paths = [path for of_key, path in config.inputs() if of_key == key]
    names = ", ".join(path.name or str(path) for path in paths[:MAX_NAMED])
    others = len(paths) - MAX_NAMED
    return f"{names} and {others} more" if others > 0 else names


def fit_command(output: Path, arguments: str) -> str:
    """Return the line `shapefit fit ARGUMENTS`, `output` for {}; "" for output `-`."""
    if output == Path("-"):
        return ""
    return f"shapefit fit {arguments.format(as_typed(output))}"


WITH_CONFIG = ("learn-dict", "project", "fit", "eval", "convert", "info", "view")
"""Commands whose keys can stand in a YAML file."""


@click.command(
    "config",
    short_help="List the config keys of a command.",
    epilog=end_of_help(
        [
            "shapefit config fit",
            "shapefit config fit camera",
            "shapefit config learn-dict prior.components",
        ]
    ),
)
@click.argument("command", type=click.Choice(WITH_CONFIG))
@click.argument("section", required=False, default="", type=SECTION)
@as_json
def config(command: str, section: str, as_json: bool) -> int:
    """List the config keys of a command: what each expects, its default, what it means.

    SECTION is a section of the config, or a single key: only those are listed.
    """
    import json
    import shutil

    from shapefit.config import CONFIGS
    from shapefit.config.reference import describe_keys

    table = describe_keys(CONFIGS[command], section)
    if as_json:
        keys = [row._asdict() for row in table]
        click.echo(json.dumps({"command": "config", "keys": keys}, ensure_ascii=False))
        return 0
    click.echo(
        format_keys(table, min(100, shutil.get_terminal_size().columns)), nl=False
    )
    return 0


def format_keys(table: Sequence[KeyInWords], width: int) -> str:
    """Return config keys with their meanings as lines of text of at most `width`."""
    from textwrap import wrap

    lines = []
    for row in table:
        default = row.default if row.default == "required" else f"default {row.default}"
        lines.append(f"{row.name}: {row.expects}; {default}")
        lines += wrap(
            row.meaning, width, initial_indent="    ", subsequent_indent="    "
        )
    return "\n".join(lines) + "\n"


COMMANDS = (
    *(learn_dict, project, fit, evaluate, convert, info, view, verify),
    config,
)
