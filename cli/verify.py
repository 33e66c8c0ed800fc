"""`shapefit verify` and `shapefit config`, which have no config of their own."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import click

from .commands import COMMANDS
from .options import DICTIONARY, option, reporting_options
from .report import Report


def _verify(
    result: str,
    dictionary: str,
    landmarks: tuple[str, ...],
    quiet: bool,
    verbose: bool,
    as_json: bool,
) -> int:
    from shapefit.pipelines.verify import Request, run

    report = Report("verify", "image", quiet, verbose, prints_note=True, as_json=as_json)
    path = Path(dictionary)
    if not path.is_file():
        from shapefit.config.paths import find_dictionaries

        path = find_dictionaries().get(dictionary, path)
    return report.follow(run(Request(Path(result), path, tuple(map(Path, landmarks)))))


def _config(command: str, section: str, as_json: bool) -> int:
    from shapefit.config.reference import find_rows, keys_text

    if as_json:
        rows = [row._asdict() for row in find_rows(command, section)]
        click.echo(json.dumps({"command": "config", "keys": rows}, ensure_ascii=False))
        return 0
    width = min(100, shutil.get_terminal_size().columns)
    click.echo(keys_text(command, section, width), nl=False)
    return 0


_DICTIONARY = "Dictionary of the fit, or the name of an installed one."
_LANDMARKS = "Landmarks of the fit, to compare with those in the result. Repeatable."

verify = click.Command(
    "verify",
    callback=_verify,
    params=[
        click.Argument(["result"], metavar="RESULT", type=click.Path()),
        option("-d --dictionary", _DICTIONARY, "DICT.h5", required=True, type=DICTIONARY),
        option("--landmarks", _LANDMARKS, "FILE", multiple=True, type=click.Path()),
        *reporting_options(),
    ],
    short_help="Check the certificates in a result.",
    help="""Check a result without the solver; print a summary to stdout.

RESULT is an HDF5 file that fit wrote, or a folder of them. For the methods convex and
convex+refine the certificate of every image is computed again. Digests, datasets and ranges
are checked, and with --landmarks the landmarks. Images with a false claim count as failed.""",
    epilog="""\b
Examples:
  shapefit verify result.h5 -d dict.h5
  shapefit verify result.h5 -d dict.h5 --landmarks views.h5
""",
)

config = click.Command(
    "config",
    callback=_config,
    params=[
        click.Argument(["command"], type=click.Choice([spec.name for spec in COMMANDS])),
        click.Argument(["section"], required=False, default=""),
        option("--json as_json", "Print one JSON object to stdout."),
    ],
    short_help="List the config keys of a command.",
    help="""List the config keys of a command: what each expects, its default, what it means.

SECTION is a section of the config, or a single key: only those are listed.""",
    epilog="""\b
Examples:
  shapefit config fit
  shapefit config fit camera
  shapefit config learn-dict prior.components
""",
)
