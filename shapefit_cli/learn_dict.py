"""`shapefit learn-dict`."""

from __future__ import annotations

from pathlib import Path

import click

from .command import run_command
from .options import common_options


@click.command(
    "learn-dict",
    short_help="Learn a dictionary from 3D shapes.",
    epilog="""\b
Examples:
  shapefit learn-dict -c learn-dict.yaml
  shapefit learn-dict -c learn-dict.yaml 'train/*.h5' -o dict.h5 --set k=128
  shapefit learn-dict train.csv -o dict.h5 --set beta=0.05 --print-config
""",
)
@click.argument("shapes", nargs=-1)
@common_options
@click.option("-o", "--output", metavar="DICT.h5", help="Dictionary file to write (HDF5).")
def learn_dict(
    shapes: tuple[str, ...],
    output: str | None,
    config_path: Path | None,
    overrides: tuple[str, ...],
    print_config: bool,
) -> int:
    """Learn a dictionary of rotatable basis shapes from 3D shapes.

    SHAPES are files of 3D shapes, HDF5 or CSV; globs work.
    """
    return run_command(
        "learn-dict",
        "learn_dict.run",
        unit="step",
        config_path=config_path,
        overrides=overrides,
        print_config=print_config,
        arguments={"shapes": shapes, "output": output},
    )
