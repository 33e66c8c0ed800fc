"""The commands: one table of texts and options, and how a row of it becomes a command of click."""

from __future__ import annotations

import gc
import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from .report import Report
from .streams import tell

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from shapefit.pipelines.outcome import Outcome

TRACEBACK_VARIABLE = "SHAPEFIT_TRACEBACK"


class Key(NamedTuple):
    """An option that sets a key of the config, `a.b` in a section."""

    key: str
    option: click.Option


class Spec(NamedTuple):
    """A command: its texts, its argument, and the options that are keys of its config.

    inputs     the argument, a key of the config, and how the usage shows it
    required   keys without which the command does nothing
    unit       what the progress bar counts
    to_stdout  the last note of the pipeline is the result of the command, for stdout
    has_config whether its keys can stand in a YAML file
    following  the next command; {output} is the file that was written
    """

    name: str
    unit: str
    summary: str
    text: str
    examples: tuple[str, ...]
    inputs: tuple[str, str]
    options: tuple[Key, ...]
    required: tuple[str, ...] = ()
    to_stdout: bool = False
    following: str = ""
    has_config: bool = True


class Named(click.types.StringParamType):
    """A text that the shell completes with installed names of a kind, or else with files."""

    def __init__(self, kind: str) -> None:
        self._kind = kind

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Offer the names that begin so; where none does, files."""
        from click.shell_completion import CompletionItem

        names = installed(self._kind, ctx.command.name or "")
        found = [CompletionItem(name) for name in names if name.startswith(incomplete)]
        return found or click.Path().shell_complete(ctx, param, incomplete)


def installed(kind: str, command: str) -> Mapping[str, Any]:
    """Return dictionaries, skeletons, methods, or configs of a command, by name."""
    from shapefit.config.paths import find_dictionaries, find_presets
    from shapefit.io.skeletons import installed_skeletons
    from shapefit.lifting.methods import METHODS

    match kind:
        case "dictionary":
            return find_dictionaries()
        case "skeleton":
            return installed_skeletons()
        case "method":
            return METHODS
    return find_presets(command)


def size(text: str) -> list[float]:
    """Return the width and height of a text such as 1920x1080."""
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


def option(names: str, help: str, metavar: str | None = None, **settings: Any) -> click.Option:
    """Return an option of these names, with a space between them; without metavar it is a flag."""
    settings |= {"is_flag": True} if metavar is None else {}
    return click.Option(names.split(), metavar=metavar, help=help, **settings)


def key(
    names: str, help: str, metavar: str | None, type: Any = None, to: str = "", **settings: Any
) -> Key:
    """Return the option of these names for the key `to`, by default called as the last name.

    A flag is None where it is not given.
    """
    to = to or names.split()[-1].lstrip("-").replace("-", "_")
    settings |= {"default": None} if metavar is None else {"type": type}
    return Key(to, option(f"{names} {identifier(to)}", help, metavar, **settings))


def identifier(key: str) -> str:
    """Return a key as click names a parameter."""
    return f"key_{key.replace('.', '__')}"


OUTPUT = "-o --output"
DICTIONARY = Named("dictionary")
PEOPLE = "Dictionary: a file, or an installed one (default: people)."
MATCH = "item, frame, or a dataset that names the true shape."
RATE = key("--frame-rate", "Frames per second, if the files do not state it.", "HZ", float)
HEIGHT = key("--height", "Height of the person in metres.", "METRES", float)
SKELETON = Named("skeleton")
KEYPOINTS = key("--keypoints", "Skeleton of files without names: body_25 ...", "NAME", SKELETON)
INDIVIDUAL = key("--individual", "Read only this individual.", "NAME")
CONFIDENCE = key("--min-confidence", "Hide less confident landmarks.", "NUMBER", float)
SIZE = key("--image-size", "Size of the images in pixels, such as 1920x1080.", "WxH", size)
EVERY = key("--every", "Take every n-th frame.", "N", int)
MARKERS = key("--markers", "TRC markers: joints, or input (detector names).", "WHICH")
TRUTH = key("--truth", "File of the true 3D shapes. Repeatable.", "SHAPES", multiple=True)

COMMANDS = (
    Spec(
        "learn-dict",
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
        following="shapefit fit LANDMARKS -d {output} -o result.h5",
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
        following="shapefit fit {output} -d DICT.h5 -o result.h5",
        options=(
            key(OUTPUT, "Landmark file to write; - is stdout (CSV).", "LANDMARKS"),
            key("--noise", "Standard deviation of noise on each coordinate.", "NUMBER", float),
            key("--seed", "Seed of random choices.", "N", int),
        ),
    ),
    Spec(
        "fit",
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
            key("--method", "sequences, posterior, convex, ... (default: by dictionary).", "NAME",
                Named("method")),
            KEYPOINTS,
            INDIVIDUAL,
            CONFIDENCE,
            RATE,
            SIZE,
            key("--focal", "Focal length in pixels; none is weak perspective.", "NUMBER",
                number_or_word, to="camera.focal"),
            key("--calibration", "Calibration file of the cameras.", "FILE",
                to="camera.calibration"),
            key("--camera", "Camera of the calibration that took the images.", "NAME",
                to="camera.name"),
            HEIGHT,
            MARKERS,
            key("--lambda", "Weight of the norms, or auto.", "NUMBER", number_or_word),
            key("--noise", "Standard deviation of a landmark in pixels.", "NUMBER", float),
            key("--workers", "Fit the parts with N processes.", "N", int),
            key("--scheduler", "Fit the parts on a running Dask cluster.", "ADDRESS"),
            key("--scheduler-file", "The same, by the file of the scheduler.", "FILE"),
            key("--dry-run", "Only list the parts.", None),
            key("--replace", "Replace other results in the folder.", None),
            key("--fail-untrusted", "Exit with 1 if more than this share (0 to 1) of the images "
                "is not trusted.", "SHARE", click.FloatRange(0, 1)),
        ),
    ),
    Spec(
        "eval",
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
        to_stdout=True,
        options=(
            key(OUTPUT, "Folder to write the report to.", "DIR"),
            TRUTH,
            key("--match", MATCH, "NAME"),
        ),
    ),
    Spec(
        "convert",
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
        unit="file",
        summary="Describe files and print the next command.",
        text="""Describe files and print the next command; without files, list what is installed.

FILEs are of any format that can be read, or folders with one file per frame.""",
        examples=("shapefit info", "shapefit info mouseDLC.h5", "shapefit info cam01_json/"),
        inputs=("files", "[FILE]..."),
        to_stdout=True,
        options=(KEYPOINTS, key("--format", "Format of the files.", "FORMAT")),
    ),
    Spec(
        "view",
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
            key("--match", MATCH, "NAME"),
            key("-d --dictionary", "Dictionary with edges and meshes to draw.", "DICT", DICTIONARY),
            key("--images", "Images under the landmarks.", "FOLDER"),
            KEYPOINTS,
            RATE,
            key("--open", "Open the page in a browser.", None, to="opens"),
        ),
    ),
    Spec(
        "verify",
        unit="image",
        summary="Check the certificates in a result.",
        text="""Check a result without the solver; print a summary to stdout.

RESULT is an HDF5 file that fit wrote, or a folder of them. For the methods convex and
convex+refine the certificate of every image is computed again. Digests, datasets and ranges
are checked, and with --landmarks the landmarks. Images with a false claim count as failed.""",
        examples=(
            "shapefit verify result.h5 -d dict.h5",
            "shapefit verify result.h5 -d dict.h5 --landmarks views.h5",
        ),
        inputs=("result", "RESULT"),
        required=("result", "dictionary"),
        to_stdout=True,
        has_config=False,
        options=(
            key("-d --dictionary", "Dictionary of the fit: a file, or an installed one.", "DICT",
                DICTIONARY),
            key("--landmarks", "Landmarks of the fit, to compare with the result's. Repeatable.",
                "FILE", multiple=True),
        ),
    ),
)  # fmt: skip
"""In the order of the help, which is that of the chain."""


def run_pipeline(command: str, config: Any) -> Iterator[Outcome]:
    """Run the pipeline of a command; only that one is imported."""
    match command:
        case "learn-dict":
            from shapefit.pipelines.learn_dict.run import run as learn_dict

            return learn_dict(config)
        case "project":
            from shapefit.pipelines.projection import run as project

            return project(config)
        case "fit" if hasattr(config.output, "manifest"):
            from shapefit.pipelines.partition.run import run as fit_parts

            return fit_parts(config)
        case "fit":
            from shapefit.pipelines.fit.run import run as fit

            return fit(config)
        case "eval":
            from shapefit.pipelines.evaluate.run import run as evaluate

            return evaluate(config)
        case "convert":
            from shapefit.pipelines.convert import run as convert

            return convert(config)
        case "info":
            from shapefit.pipelines.info import run as info

            return info(config)
        case "view":
            from shapefit.pipelines.view.run import run as view

            return view(config)
    from shapefit.pipelines.verify import Request
    from shapefit.pipelines.verify import run as verify

    path = Path(config.dictionary)
    if not path.is_file():
        path = Path(installed("dictionary", command).get(config.dictionary, path))
    return verify(Request(Path(config.result), path, tuple(map(Path, config.landmarks))))


def make_command(spec: Spec) -> click.Command:
    """Return the click command of a row of the table."""
    inputs, metavar = spec.inputs
    keys = f"Set any key of the config (shapefit config {spec.name}). Repeatable."
    of_config = [
        option("-c --config config_path", "Config file (- is stdin), or an installed one.",
               "CONFIG", type=Named("config")),
        option("--set overrides", keys, "KEY=VALUE", multiple=True),
        option("--print-config", "Print the config with every default as YAML, and exit."),
    ]  # fmt: skip
    where = f"Show where an internal error arose (as {TRACEBACK_VARIABLE}=1 does)."
    of_report = [
        option("--json as_json", "Print one JSON object to stdout at the end."),
        option("-q --quiet", "Print only errors and failed items.", is_eager=True),
        option("-v --verbose", "Show all warnings, failed items and files.", callback=_not_both),
        option("--traceback", where, callback=_show_traceback, is_eager=True, expose_value=False),
    ]
    return click.Command(
        spec.name,
        callback=partial(run_command, spec),
        params=[
            click.Argument(
                [identifier(inputs)],
                nargs=-1 if "..." in metavar else 1,
                required=False,
                metavar=metavar,
            ),
            *(each.option for each in spec.options),
            *(of_config if spec.has_config else ()),
            *of_report,
        ],
        short_help=spec.summary,
        help=spec.text,
        epilog=_examples(spec.examples),
    )


def _not_both(context: click.Context, _option: click.Parameter, verbose: bool) -> bool:
    if verbose and context.params.get("quiet"):
        raise click.UsageError("-q and -v exclude each other; give one of them", context)
    return verbose


def _show_traceback(_context: click.Context, _option: click.Parameter, wanted: bool) -> None:
    if wanted:
        os.environ[TRACEBACK_VARIABLE] = "1"


def _examples(lines: Sequence[str]) -> str:
    return "\n".join(["\b", "Examples:", *(f"  {line}" for line in lines), ""])


def run_command(
    spec: Spec,
    *,
    quiet: bool,
    verbose: bool,
    as_json: bool,
    config_path: str | None = None,
    overrides: Sequence[str] = (),
    print_config: bool = False,
    **options: Any,
) -> int:
    """Run the pipeline of a command with its config; return the exit code.

    With `print_config` the config is printed to stdout instead. Raises InputError on a wrong
    config, and click.UsageError where an argument is missing.
    """
    # No plug-in changes the schema, and looking for them in all installed packages takes long.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    keys = (spec.inputs[0], *(each.key for each in spec.options))
    arguments = {key: options[identifier(key)] for key in keys}
    opens = arguments.pop("opens", None)
    max_untrusted = arguments.pop("fail_untrusted", None)
    if config_path is None and not print_config:
        check_required(spec, arguments, overrides)
    if spec.has_config:
        from shapefit.config import dump_config, load_config

        config = load_config(
            spec.name,
            Path(config_path) if config_path else None,
            overrides,
            arguments,
            name=partial(_name_of, spec),
            stand_ins=dict.fromkeys((*spec.required, "output")) if print_config else None,
        )
        if print_config:
            click.echo(dump_config(config), nl=False)
            return 0
    else:
        config = SimpleNamespace(**arguments)
    output = getattr(config, "output", None)
    if as_json and output == Path("-"):
        raise click.UsageError("--json and the output both go to stdout; name a file as output")
    outcomes = run_pipeline(spec.name, config)
    if not gc.isenabled():
        gc.freeze()  # or the first look for cycles goes through all that was imported
        gc.enable()
    report = Report(
        spec.name,
        spec.unit,
        quiet,
        verbose,
        spec.to_stdout,
        as_json,
        max_untrusted=max_untrusted,
        following=spec.following.format(output=getattr(output, "name", "")),
    )
    if spec.has_config:
        report.read = _names([path for key, path in config.inputs() if key == spec.inputs[0]])
    code = report.follow(outcomes)
    if opens:
        _open_in_browser(report.written)
    return code


def check_required(spec: Spec, arguments: Mapping[str, Any], overrides: Sequence[str]) -> None:
    """Raise click's error, with an example, where an argument that is needed is missing."""
    context = click.get_current_context()
    parameters = {each.name: each for each in context.command.params}
    given = {override.partition("=")[0].strip() for override in overrides}
    for key in spec.required:
        if not arguments[key] and key not in given:
            example = f"For example: {spec.examples[0]}"
            raise click.MissingParameter(example, context, parameters[identifier(key)])


def _name_of(spec: Spec, key: str) -> str:
    """Return what the command line calls a key: its option, or the argument."""
    names = {each.key: each.option.opts[-1] for each in spec.options}
    return names.get(key, spec.inputs[1].strip("[]."))


def _names(paths: Sequence[Path]) -> str:
    """Name the first inputs and count the others."""
    more = f" and {len(paths) - 3} more" if len(paths) > 3 else ""
    return ", ".join(path.name or str(path) for path in paths[:3]) + more


def _open_in_browser(paths: Sequence[Path]) -> None:
    import webbrowser

    for path in paths:
        if not webbrowser.open(path.resolve().as_uri()):
            tell(f"No browser was found; open {path} in one.")


def list_keys(command: str, section: str, as_json: bool) -> int:
    """Print the config keys of a command, or those of one section."""
    from shapefit.config.reference import find_rows, keys_text

    if as_json:
        rows = [row._asdict() for row in find_rows(command, section)]
        click.echo(json.dumps({"command": "config", "keys": rows}, ensure_ascii=False))
        return 0
    width = min(100, shutil.get_terminal_size().columns)
    click.echo(keys_text(command, section, width), nl=False)
    return 0


config_command = click.Command(
    "config",
    callback=list_keys,
    params=[
        click.Argument(["command"], type=click.Choice([c.name for c in COMMANDS if c.has_config])),
        click.Argument(["section"], required=False, default=""),
        option("--json as_json", "Print one JSON object to stdout."),
    ],
    short_help="List the config keys of a command.",
    help="""List the config keys of a command: what each expects, its default, what it means.

SECTION is a section of the config, or a single key: only those are listed.""",
    epilog=_examples(
        (
            "shapefit config fit",
            "shapefit config fit camera",
            "shapefit config learn-dict prior.components",
        )
    ),
)
