"""One run of a command: config, pipeline, report."""

from __future__ import annotations

import gc
import importlib
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path

import click

from .progress import Progress
from .report import Report
from .streams import tell


def run_command(
    command: str,
    pipeline: str,
    *,
    unit: str,
    config_path: Path | None,
    overrides: Sequence[str],
    print_config: bool,
    arguments: Mapping[str, object],
    note_is_result: bool = False,
    afterwards: Callable[[Report], None] | None = None,
) -> int:
    """Run `shapefit.pipelines.<pipeline>` with the config of `command`; return the exit code.

    With `print_config` the config is printed to stdout instead. `unit` is what the progress bar
    counts. Where `note_is_result` the last note is the result of the command, for stdout;
    otherwise notes are states of the work, for the bar. `afterwards` is called with the report when
    all is done. Raises InputError on a wrong config.
    """
    # No plug-in changes the schema, and looking for them in all installed packages takes long.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    from shapefit.config import dump_config, load_config

    config = load_config(command, config_path, overrides, arguments)
    if print_config:
        click.echo(dump_config(config), nl=False)
        return 0
    run = importlib.import_module(f"shapefit.pipelines.{pipeline}").run
    gc.enable()
    report = Report(command, unit)
    with Progress(command, unit) as progress, closing(run(config)) as outcomes:
        for outcome in outcomes:
            report.add(outcome)
            progress.advance(outcome.done, outcome.total, "" if note_is_result else outcome.note)
    if note_is_result:
        click.echo(report.note)
    for line in report.lines(with_note=not note_is_result):
        tell(line)
    if afterwards is not None:
        afterwards(report)
    return report.exit_code
