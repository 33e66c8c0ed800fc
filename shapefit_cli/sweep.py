"""`shapefit sweep`."""

from __future__ import annotations

from pathlib import Path

import click

from .command import run_command
from .options import common_options


@click.command(
    "sweep",
    short_help="Run the chain over the values of one key.",
    epilog="""\b
Examples:
  shapefit sweep -c sensitivity-lambda.yaml
  shapefit sweep -c sweep.yaml -o lambda/ --set 'vary={fit.lambda: [0.05, 0.1, 0.2]}'
  shapefit sweep -c sweep.yaml --set 'vary={fit.method: [convex, alternate]}' > table.md
""",
)
@common_options
@click.option("-o", "--output", metavar="DIR", help="Folder to write the report to.")
def sweep(
    output: str | None,
    config_path: Path | None,
    overrides: tuple[str, ...],
    print_config: bool,
) -> int:
    """Run learn-dict, project, fit and eval for each value of one key.

    Prints the table of errors and times against the key (Markdown) to stdout; the report draws
    it.
    """
    return run_command(
        "sweep",
        "sweep.run",
        unit="image",
        config_path=config_path,
        overrides=overrides,
        print_config=print_config,
        arguments={"output": output},
        note_is_result=True,
    )
