"""`shapefit verify`."""

from __future__ import annotations

import os
from contextlib import closing
from pathlib import Path

import click

from .options import traceback_option
from .progress import Progress
from .report import Report
from .streams import tell


@click.command(
    "verify",
    short_help="Check the proofs in a result.",
    epilog="""\b
Examples:
  shapefit verify result.h5 -d dict.h5
  shapefit verify result.h5 -d dict.h5 --landmarks views.h5 > claims.md
""",
)
@click.argument("result", metavar="RESULT", type=click.Path(path_type=Path))
@click.option(
    "-d",
    "--dictionary",
    metavar="DICT.h5",
    required=True,
    type=click.Path(path_type=Path),
    help="Dictionary of the fit.",
)
@click.option(
    "--landmarks",
    metavar="FILE",
    multiple=True,
    type=click.Path(path_type=Path),
    help="Landmarks of the fit, to compare with those in the result. Repeatable.",
)
@traceback_option
def verify(result: Path, dictionary: Path, landmarks: tuple[Path, ...]) -> int:
    """Check the proofs in a result; print a table of the claims (Markdown) to stdout.

    RESULT is an HDF5 file that fit wrote. Objective, dual bound and gap of every image are
    computed again, without the solver, and compared with the claims of the file, together with
    everything that follows from the transforms. Images with a false claim count as failed.
    """
    # Chunks are checked side by side: threads within a product would stand in each other's way.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from shapefit.pipelines.verify import Request, run

    report = Report("verify", "image")
    request = Request(result, dictionary, landmarks)
    with Progress("verify", "image") as progress, closing(run(request)) as outcomes:
        for outcome in outcomes:
            report.add(outcome)
            progress.advance(outcome.done, outcome.total, "")
    click.echo(report.note)
    for line in report.lines(with_note=False):
        tell(line)
    return report.exit_code
