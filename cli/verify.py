"""`shapefit verify` and `shapefit config`, which have no config of their own."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import click

from .commands import COMMANDS
from .options import DICTIONARY, option, reporting_options
from .report import Report


def _verify(
    result: str, dictionary: str, landmarks: tuple[str, ...], quiet: bool, verbose: bool
) -> int:
    # Chunks are checked side by side: threads within a product would stand in each other's way.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from shapefit.pipelines.verify import Request, run
    from shapefit.stores import location

    report = Report("verify", "image", quiet, verbose, prints_note=True)
    files = tuple(map(location, landmarks))
    return report.follow(run(Request(location(result), _find(dictionary), files)))


def _find(dictionary: str) -> Path:
    """Return the file at a path, or the installed dictionary of that name."""
    from shapefit.stores import location

    path = location(dictionary)
    if path.is_file():
        return path
    from shapefit.config.paths import find_dictionaries

    return find_dictionaries().get(dictionary, path)


def _config(command: str, section: str) -> int:
    from shapefit.config.reference import keys_text

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
