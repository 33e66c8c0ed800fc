"""`shapefit simulate`."""

from __future__ import annotations

from pathlib import Path

import click

from .command import run_command
from .options import common_options


@click.command(
    "simulate",
    short_help="Measure exact recovery on planted instances.",
    epilog="""\b
Examples:
  shapefit simulate -c recovery.yaml
  shapefit simulate -o recovery/ --set trials=10 --set 'landmarks=[10, 20]'
  shapefit simulate -c recovery.yaml --set translation=none -o literal/ > recovery.md
""",
)
@common_options
@click.option("-o", "--output", metavar="DIR", help="Folder to write the report to.")
def simulate(
    output: str | None,
    config_path: Path | None,
    overrides: tuple[str, ...],
    print_config: bool,
) -> int:
    """Measure how often the noiseless program finds planted transforms exactly.

    Random instances over a grid of landmarks and atoms in use; prints the table of shares
    (Markdown) to stdout.
    """
    return run_command(
        "simulate",
        "simulate",
        unit="trial",
        config_path=config_path,
        overrides=overrides,
        print_config=print_config,
        arguments={"output": output},
        note_is_result=True,
    )
