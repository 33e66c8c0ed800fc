"""`shapefit project`."""

from __future__ import annotations

from pathlib import Path

import click

from .command import run_command
from .options import common_options


@click.command(
    "project",
    short_help="Project 3D shapes to synthetic 2D landmarks.",
    epilog="""\b
Examples:
  shapefit project -c project.yaml
  shapefit project -c project.yaml test.h5 -o views.h5 --set noise=0.01 --set hidden=0.2
  shapefit project test.h5 -o - --set camera.view=random > views.csv
""",
)
@click.argument("shapes", nargs=-1)
@common_options
@click.option(
    "-o", "--output", metavar="LANDMARKS", help="Landmark file to write; - is stdout (CSV)."
)
def project(
    shapes: tuple[str, ...],
    output: str | None,
    config_path: Path | None,
    overrides: tuple[str, ...],
    print_config: bool,
) -> int:
    """Project 3D shapes to synthetic 2D landmarks with a known camera.

    SHAPES are files of 3D shapes, HDF5 or CSV; globs work, - is stdin (CSV).
    """
    return run_command(
        "project",
        "project.run",
        unit="image",
        config_path=config_path,
        overrides=overrides,
        print_config=print_config,
        arguments={"shapes": shapes, "output": output},
    )
