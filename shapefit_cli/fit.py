"""`shapefit fit`."""

from __future__ import annotations

from pathlib import Path

import click

from .command import run_command
from .options import common_options


@click.command(
    "fit",
    short_help="Lift 2D landmarks to 3D shapes.",
    epilog="""\b
Examples:
  shapefit fit -c fit.yaml
  shapefit fit -c fit.yaml 'views/*.h5' -d dict.h5 -o result.h5 --set lambda=0.2
  shapefit fit -d dict.h5 -o - - < landmarks.csv > shapes.csv
""",
)
@click.argument("landmarks", nargs=-1)
@common_options
@click.option("-o", "--output", metavar="RESULT", help="Result file to write; - is stdout (CSV).")
@click.option("-d", "--dictionary", metavar="DICT.h5", help="Dictionary that learn-dict wrote.")
def fit(
    landmarks: tuple[str, ...],
    dictionary: str | None,
    output: str | None,
    config_path: Path | None,
    overrides: tuple[str, ...],
    print_config: bool,
) -> int:
    """Lift 2D landmarks in single images to 3D shapes.

    LANDMARKS are files of 2D landmarks, HDF5 or CSV; globs work, - is stdin (CSV).
    """
    return run_command(
        "fit",
        "fit.run",
        unit="image",
        config_path=config_path,
        overrides=overrides,
        print_config=print_config,
        arguments={"landmarks": landmarks, "dictionary": dictionary, "output": output},
    )
