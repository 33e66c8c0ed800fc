"""The commands: one table of texts and options, and how a row of it becomes a command
of click.
"""

from __future__ import annotations

import gc
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from textwrap import wrap
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from shapefit.errors import as_typed

from .report import Report, tell

if TYPE_CHECKING:
    from shapefit.config.reference import KeyInWords
    from shapefit.pipelines.result import Result

TRACEBACK_VARIABLE = "SHAPEFIT_TRACEBACK"


class Spec(NamedTuple):
    """A command: its texts, its argument, the options that are keys of its config."""

    name: str

    unit: str
    """What the progress bar counts."""

    inputs: tuple[str, str]
    """The argument, a key of the config, and how the usage shows it."""

    required: tuple[str, ...]
    """Keys without which the command does nothing."""

    text: str
    """The help; its first line is the summary."""

    options: str
    """A line each: names, metavar (a flag has none), help after two spaces."""

    examples: str

    to_stdout: bool = False
    """Whether the last note of the pipeline is the result, for standard output."""

    has_config: bool = True
    """Whether its keys can stand in a YAML file."""

    following: str = ""
    """The next command; {output} is the file that was written."""


READING_OPTIONS = """
--keypoints SKELETON  Skeleton of files without names: body_25 ...
--individual NAME  Read only this individual.
--min-confidence NUMBER  Hide less confident landmarks.
"""
METRES_OPTIONS = """
--frame-rate HZ  Frames per second, if the files do not state it.
--image-size WxH  Size of the images in pixels, such as 1920x1080.
--height METRES  Height of the person in metres.
--markers WHICH  TRC markers: joints, or input (detector names).
"""
TRUTH_OPTIONS = """
--truth SHAPES  File of the true 3D shapes. Repeatable.
--match NAME  item, frame, or a dataset that names the true shape.
"""
CONFIG_OPTIONS = """
-c --config CONFIG  Config file (- is stdin), or an installed one.
--set KEY=VALUE  Set any key of the config (shapefit config {name}). Repeatable.
--print-config  Print the config with every default as YAML, and exit.
"""
REPORT_OPTIONS = """
--json  Print one JSON object to stdout at the end.
-q --quiet  Print only errors and failed items.
-v --verbose  Show all warnings, failed items and files.
--traceback  Show where an internal error arose (as SHAPEFIT_TRACEBACK=1 does).
"""

COMMANDS = (
    Spec(
        "learn-dict",
        unit="round",
        inputs=("shapes", "SHAPES..."),
        required=("shapes",),
        following="shapefit fit LANDMARKS -d {output} -o result.h5",
        text="""\
Learn a dictionary of rotatable shapes from 3D shapes, or from 2D landmarks.

SHAPES are files of 3D shapes, or of 2D landmarks seen from different sides
(docs/from_2d.md), in any format that can be read (docs/formats.md). Globs work.""",
        options=f"""
-o --output DICT.h5  Dictionary file to write (HDF5).
--method NAME  sparse-coding, exemplars or pca-bases.
--every N  Take every n-th frame.
--prior  Learn a prior over shapes too, so that a fit has error bars.
{READING_OPTIONS}""",
        examples="""
shapefit learn-dict train.h5 -o dict.h5 --prior
shapefit learn-dict 'train/*.h5' -o dict.h5 --every 3 --set k=128
shapefit learn-dict tracked.csv -o animal.h5""",
    ),
    Spec(
        "project",
        unit="image",
        inputs=("shapes", "SHAPES..."),
        required=("shapes",),
        following="shapefit fit {output} -d DICT.h5 -o result.h5",
        text="""Project 3D shapes to synthetic 2D landmarks with a known camera.

SHAPES are files of 3D shapes in any format that can be read (docs/formats.md). Globs
work, - is stdin (CSV).""",
        options="""
-o --output LANDMARKS  Landmark file to write; - is stdout (CSV).
--noise NUMBER  Standard deviation of noise on each coordinate.
--seed N  Seed of random choices.""",
        examples="""
shapefit project test.h5 -o views.h5
shapefit project test.h5 -o - --set camera.view=random > views.csv""",
    ),
    Spec(
        "fit",
        unit="image",
        inputs=("landmarks", "LANDMARKS..."),
        required=("landmarks",),
        text="""Lift 2D landmarks in single images or videos to 3D shapes.

LANDMARKS are files of 2D landmarks in any format that can be read, or folders with one
file per frame (docs/formats.md). Globs work, - is stdin (CSV).""",
        options=f"""
-o --output RESULT  Result file; - is stdout (CSV), FOLDER/ one file per part.
-d --dictionary DICT  Dictionary: a file, or an installed one (default: people).
--method METHOD  sequences, posterior, convex, ... (default: by dictionary).
{READING_OPTIONS}{METRES_OPTIONS}
--focal FOCAL  Focal length in pixels; none is weak perspective.
--calibration FILE  Calibration file of the cameras.
--camera NAME  Camera of the calibration that took the images.
--lambda LAMBDA  Weight of the norms, or auto.
--noise NUMBER  Standard deviation of a landmark in pixels.
--partition COUNT  Images of a part of a folder (default: 100,000).
--workers COUNT  Fit the parts with this many processes.
--scheduler ADDRESS  Fit the parts on a running Dask cluster.
--scheduler-file SCHEDULER.json  The same, by the file of the scheduler.
--replace  Replace other results in the folder.
--fail-untrusted SHARE  Exit with 1 if more of the images than this are not trusted.""",
        examples="""
shapefit fit cam01_json/
shapefit fit cam01_json/ -o man.trc --image-size 1920x1080 --height 1.78
shapefit fit views.h5 -d dict.h5 -o result.h5 --method convex --lambda 0.2
shapefit fit 'day1/*.h5' -d dict.h5 -o results/ --workers 4
shapefit fit -d dict.h5 -o - - < landmarks.csv > shapes.csv""",
    ),
    Spec(
        "eval",
        unit="image",
        inputs=("results", "RESULT..."),
        required=("results", "truth"),
        to_stdout=True,
        text="""Compare results with the truth; print the errors to stdout.

RESULTs are files that fit wrote; globs work. In the report each has the name of its
file; the config can set other names.""",
        options=f"-o --output DIR  Folder to write the report to.\n{TRUTH_OPTIONS}",
        examples="""
shapefit eval result.h5 --truth test.h5 -o report/
shapefit eval convex.h5 pmp.h5 --truth 'test/*.h5' -o report/ > errors.txt""",
    ),
    Spec(
        "convert",
        unit="item",
        inputs=("files", "INPUT..."),
        required=("files", "output"),
        text="""\
Write landmarks, shapes or results in another format, or meshes of a result.

INPUTs are files of any format that can be read, or folders with one file per frame
(docs/formats.md). The format of the output follows from its name, or --to.""",
        options=f"""
-o --output OUTPUT  File to write; - is stdout (CSV).
--to FORMAT  Format to write, such as csv or ply.
-d --dictionary DICT  Dictionary with the meshes.
{READING_OPTIONS}{METRES_OPTIONS}
--every N  Take every n-th frame.""",
        examples="""
shapefit convert mouseDLC.csv -o mouse.h5
shapefit convert labels.slp -o - --individual mouse1 > mouse1.csv
shapefit convert result.h5 -d cars.h5 -o meshes/ --to ply""",
    ),
    Spec(
        "info",
        unit="file",
        inputs=("files", "[FILE]..."),
        required=(),
        to_stdout=True,
        text="""\
Describe files and print the next command; without files, list what is installed.

FILEs are of any format that can be read, or folders with one file per frame.""",
        options="""
--keypoints SKELETON  Skeleton of files without names: body_25 ...
--format FORMAT  Format of the files.""",
        examples="""
shapefit info
shapefit info cam01_json/""",
    ),
    Spec(
        "view",
        unit="frame",
        inputs=("files", "FILE..."),
        required=("files",),
        text="""\
Write one HTML page that shows results, to rotate and play, or a sheet of pictures.

The page needs no network and no server: send it to a colleague. It shows 3D on the
left, the image on the right, and below them joint angles and errors over time.""",
        options=f"""
-o --output PAGE.html  HTML file to write, or PNG or SVG.
{TRUTH_OPTIONS}
-d --dictionary DICT  Dictionary with edges and meshes to draw.
--images FOLDER  Images under the landmarks.
--keypoints SKELETON  Skeleton of files without names: body_25 ...
--frame-rate HZ  Frames per second, if the files do not state it.
--open  Open the page in a browser.""",
        examples="""
shapefit view result.h5
shapefit view convex.h5 pmp.h5 --truth test.h5 -o page.html --open
shapefit view cars.h5 --truth models.h5 --match true_model --images frames/""",
    ),
    Spec(
        "verify",
        unit="image",
        inputs=("result", "RESULT"),
        required=("result", "dictionary"),
        to_stdout=True,
        has_config=False,
        text="""\
Check the certificates in a result without the solver; print a summary to stdout.

RESULT is an HDF5 file that fit wrote, or a folder of them. For the methods convex and
convex+refine the certificate of every image is computed again. Digests of all that the
files hold, datasets and ranges are compared, and with --landmarks the landmarks. Images
with a false claim count as failed.""",
        options="""
-d --dictionary DICT  Dictionary of the fit: a file, or an installed one.
--landmarks FILE  Landmarks of the fit, to compare with the result's. Repeatable.""",
        examples="""
shapefit verify result.h5 -d dict.h5
shapefit verify result.h5 -d dict.h5 --landmarks views.h5""",
    ),
)
"""In the order of the help, which is that of the chain."""

KEY_OF_OPTION = {
    "focal": "camera.focal",
    "prior": "prior.components",
    "calibration": "camera.calibration",
    "camera": "camera.name",
}
"""Options that are called otherwise than their key."""

VALUE_OF_FLAG = {"prior": "auto"}
"""Flags that set their key to something else than true."""

PARTS_OPTIONS = ("partition", "workers", "scheduler", "scheduler_file", "replace")
OPTIONS_WITHOUT_KEY = ("open", "fail_untrusted", *PARTS_OPTIONS)
"""Options that are not keys of the config."""


def size(text: str) -> list[float]:
    """Return width and height in a text such as 1920x1080; BadParameter for others."""
    try:
        width, height = map(float, text.lower().split("x"))
    except ValueError:
        fault = f"{text!r} is no size; give WIDTHxHEIGHT, such as 1920x1080"
        raise click.BadParameter(fault) from None
    return [width, height]


def number_or_word(text: str) -> object:
    """Return a number where the text is one; the config checks words such as auto."""
    try:
        return float(text)
    except ValueError:
        return text


TYPE_OF_METAVAR: dict[str, object] = {
    **dict.fromkeys(("NUMBER", "HZ", "METRES"), float),
    **dict.fromkeys(("FOCAL", "LAMBDA"), number_or_word),
    **dict.fromkeys(("CONFIG", "DICT"), click.Path(allow_dash=True)),
    "N": int,
    "COUNT": click.IntRange(min=1),
    "SCHEDULER.json": click.Path(
        exists=True, dir_okay=False, resolve_path=True, path_type=Path
    ),
    "SHARE": click.FloatRange(0, 1),
    "WxH": size,
}
"""Types of options by their metavar; others are texts."""


def make_options(lines: str) -> dict[str, click.Option]:
    """Return the options of a table, by the keys of the config that they set.

    One that is `Repeatable.` gives a tuple; a flag is None where it is not given.
    """
    options = {}
    for line in filter(None, lines.splitlines()):
        declaration, _, text = line.partition("  ")
        *names, last = declaration.split()
        settings: dict[str, Any] = {"type": TYPE_OF_METAVAR.get(last), "metavar": last}
        settings["multiple"] = text.endswith("Repeatable.")
        if last.startswith("-"):
            names += [last]
            settings = {"is_flag": True, "default": None}
            settings["flag_value"] = VALUE_OF_FLAG.get(last.lstrip("-"), True)
        name = names[-1].lstrip("-").replace("-", "_")
        options[KEY_OF_OPTION.get(name, name)] = click.Option(
            [*names, f"option_{name}"], help=text, **settings
        )
    return options


def make_command(spec: Spec) -> click.Command:
    """Return the click command of a row of the table."""
    inputs, metavar = spec.inputs
    count = -1 if "..." in metavar else 1
    common = make_options(REPORT_OPTIONS)
    if spec.has_config:
        common = make_options(CONFIG_OPTIONS.format(name=spec.name)) | common
    argument = click.Argument(
        [f"option_{inputs}"], nargs=count, required=False, metavar=metavar
    )
    return click.Command(
        spec.name,
        callback=partial(run_command, spec),
        params=[argument, *make_options(spec.options).values(), *common.values()],
        short_help=spec.text.partition("\n")[0],
        help=spec.text,
        epilog=_examples(spec.examples),
    )


def _examples(lines: str) -> str:
    """Return the end of a command's help, which lists these examples."""
    return "\b\nExamples:" + lines.replace("\n", "\n  ")


def run_command(spec: Spec, **options: Any) -> int:
    """Run the pipeline of a command with its config; return the exit code.

    With --print-config the config is printed to stdout instead. Raises InputError on a
    wrong config, and click.UsageError where an argument is missing.
    """
    given = {name.removeprefix("option_"): value for name, value in options.items()}
    if given["traceback"]:
        os.environ[TRACEBACK_VARIABLE] = "1"
    if given["quiet"] and given["verbose"]:
        raise click.UsageError("-q and -v exclude each other; give one of them")
    # No plug-in changes the schema, and looking for them in all installed packages
    # takes long.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    config = make_config(spec, given)
    if given.get("print_config"):
        from shapefit.config import dump_config

        click.echo(dump_config(config), nl=False)
        return 0
    output = getattr(config, "output", None)
    if given["json"] and output == Path("-"):
        raise click.UsageError(
            "--json and the output both go to stdout; name a file as output"
        )
    following = ""
    if isinstance(output, Path) and output != Path("-"):
        following = spec.following.format(output=as_typed(output))
    results = run_pipeline(spec.name, config)
    gc.freeze()  # or the first look for cycles goes through all that was imported
    gc.enable()
    report = Report(
        spec.name,
        spec.unit,
        quiet=given["quiet"],
        verbose=given["verbose"],
        to_stdout=spec.to_stdout,
        as_json=given["json"],
        max_untrusted=given.get("fail_untrusted"),
        read=name_inputs(spec, config) if spec.has_config else "",
        following=following,
    )
    code = report.follow(results)
    for path in report.written if given.get("open") else ():
        import webbrowser

        if not webbrowser.open(path.resolve().as_uri()):
            tell(f"No browser was found; open {path} in one.")
    return code


def make_config(spec: Spec, given: Mapping[str, Any]) -> Any:
    """Return the config of a command: its file, --set, and options.

    Raises click's error, with an example, where an argument that is needed is missing.
    """
    options = make_options(spec.options).values()
    names = {spec.inputs[0]}
    names.update(option.name.removeprefix("option_") for option in options)
    arguments = {
        KEY_OF_OPTION.get(name, name): given[name]
        for name in names.difference(OPTIONS_WITHOUT_KEY)
    }
    overrides = given.get("set") or ()
    printing = given.get("print_config")
    if given.get("config") is None and not printing:
        set_keys = {override.partition("=")[0].strip() for override in overrides}
        for key in spec.required:
            if not arguments[key] and key not in set_keys:
                raise _missing(key, spec)
    if not spec.has_config:
        return SimpleNamespace(**arguments)
    from shapefit.config import load_config

    path = Path(given["config"]) if given["config"] else None
    placeholders = None
    if printing:
        placeholders = dict.fromkeys(spec.required)
        if "output" in names:
            placeholders["output"] = None
    config = load_config(
        spec.name, path, overrides, arguments, placeholders=placeholders
    )
    return config if printing else with_parts(config, given)


def _missing(key: str, spec: Spec) -> click.MissingParameter:
    """Return the error for an argument that is needed, with an example."""
    context = click.get_current_context()
    parameters = {parameter.name: parameter for parameter in context.command.params}
    example = f"For example: {spec.examples.splitlines()[1]}"
    return click.MissingParameter(example, context, parameters[f"option_{key}"])


def with_parts(config: Any, given: Mapping[str, Any]) -> Any:
    """Return the config with options of a folder of results, where any is given.

    Raises click.UsageError where the output is no folder, and for ways that exclude
    each other.
    """
    options = {
        name: given[name] for name in PARTS_OPTIONS if given.get(name) is not None
    }
    if len(options.keys() & {"workers", "scheduler", "scheduler_file"}) > 1:
        fault = "--workers, --scheduler and --scheduler-file exclude each other"
        raise click.UsageError(f"{fault}; give one of them")
    if options and not hasattr(config.output, "manifest"):
        flag = "--" + min(options).replace("_", "-")
        raise click.UsageError(
            f"{flag} needs a folder as output, for example -o results/"
        )
    if not options:
        return config
    return config.changed(output=replace(config.output, **options))


def name_inputs(spec: Spec, config: Any) -> str:
    """Return the names of the first three input files, and the number of others."""
    paths = [path for key, path in config.inputs() if key == spec.inputs[0]]
    more = f" and {len(paths) - 3} more" if len(paths) > 3 else ""
    return ", ".join(path.name or str(path) for path in paths[:3]) + more


def run_pipeline(command: str, config: Any) -> Iterator[Result]:
    """Run the pipeline of a command; only that one is imported."""
    run: Callable[[Any], Iterator[Result]]
    match command:
        case "learn-dict":
            from shapefit.pipelines.learn_dict.run import learn_dictionary as run
        case "project":
            from shapefit.pipelines.projection import project_shapes as run
        case "fit" if hasattr(config.output, "manifest"):
            from shapefit.pipelines.partition.run import fit_parts as run
        case "fit":
            from shapefit.pipelines.fit.fit import fit as run
        case "eval":
            from shapefit.pipelines.evaluate.run import evaluate_results as run
        case "convert":
            from shapefit.pipelines.convert import convert_files as run
        case "info":
            from shapefit.pipelines.info import describe_files as run
        case "view":
            from shapefit.pipelines.view.run import write_page as run
        case _:
            from shapefit.pipelines.verify import Request
            from shapefit.pipelines.verify import verify_results as run

            path = Path(config.dictionary)
            if not path.is_file():  # the schemas of configs take long to import
                from shapefit.config.paths import find_dictionaries

                path = find_dictionaries().get(config.dictionary, path)
            config = Request(
                Path(config.result), path, tuple(map(Path, config.landmarks))
            )
    return run(config)


def print_keys(command: str, section: str, option_json: bool) -> int:
    """Print the config keys of a command, or those of one section."""
    from shapefit.config import CONFIGS
    from shapefit.config.reference import rows

    table = rows(CONFIGS[command], section)
    if option_json:
        keys = [row._asdict() for row in table]
        click.echo(json.dumps({"command": "config", "keys": keys}, ensure_ascii=False))
        return 0
    click.echo(keys_text(table, min(100, shutil.get_terminal_size().columns)), nl=False)
    return 0


def keys_text(table: Sequence[KeyInWords], width: int) -> str:
    """Return a table of keys for a terminal."""
    lines = []
    for row in table:
        default = row.default if row.default == "required" else f"default {row.default}"
        lines.append(f"{row.name}: {row.expects}; {default}")
        lines += wrap(
            row.meaning, width, initial_indent="    ", subsequent_indent="    "
        )
    return "\n".join(lines) + "\n"


config_command = click.Command(
    "config",
    callback=print_keys,
    params=[
        click.Argument(
            ["command"], type=click.Choice([c.name for c in COMMANDS if c.has_config])
        ),
        click.Argument(["section"], required=False, default=""),
        *make_options("--json  Print one JSON object to stdout.").values(),
    ],
    short_help="List the config keys of a command.",
    help="""\
List the config keys of a command: what each expects, its default, what it means.

SECTION is a section of the config, or a single key: only those are listed.""",
    epilog=_examples(
        """
shapefit config fit
shapefit config fit camera
shapefit config learn-dict prior.components"""
    ),
)
