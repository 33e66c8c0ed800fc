"""`shapefit eval`."""

from __future__ import annotations

from pathlib import Path

import click

from .command import run_command
from .options import common_options


@click.command(
    "eval",
    short_help="Compare results with the truth.",
    epilog="""\b
Examples:
  shapefit eval -c eval.yaml
  shapefit eval -c eval.yaml convex.h5 pmp.h5 --truth test.h5 -o report/
  shapefit eval result.h5 --truth 'test/*.h5' -o report/ > table.md
""",
)
@click.argument("results", nargs=-1, metavar="[RESULT]...")
@common_options
@click.option("-o", "--output", metavar="DIR", help="Folder to write the report to.")
@click.option(
    "--truth", metavar="SHAPES", multiple=True, help="File of the true 3D shapes. Repeatable."
)
def evaluate(
    results: tuple[str, ...],
    truth: tuple[str, ...],
    output: str | None,
    config_path: Path | None,
    overrides: tuple[str, ...],
    print_config: bool,
) -> int:
    """Compare results with the truth; print the table of errors (Markdown) to stdout.

    RESULTs are files that fit wrote; globs work. In the table each has the name of its file; the
    config can set other names.
    """
    return run_command(
        "eval",
        "evaluate.run",
        unit="image",
        config_path=config_path,
        overrides=overrides,
        print_config=print_config,
        arguments={"results": results, "truth": truth, "output": output},
        note_is_result=True,
    )
