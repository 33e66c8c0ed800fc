"""A click command made from a row of the table: its config, pipeline and report."""

from __future__ import annotations

import gc
import importlib
import os
from collections.abc import Sequence
from pathlib import Path

import click

from .commands import Spec
from .options import config_options, reporting_options
from .report import Report
from .streams import tell


def make_command(spec: Spec) -> click.Command:
    """Return the click command of a row of the table."""
    files, *further = spec.parameters
    return click.Command(
        spec.name,
        callback=lambda **values: run_command(spec, **values),
        params=[files, *config_options(spec.name), *further, *reporting_options()],
        short_help=spec.summary,
        help=spec.text,
        epilog=f"\b\nExamples:\n{spec.examples}\n",
    )


def run_command(
    spec: Spec,
    *,
    config_path: str | None,
    overrides: Sequence[str],
    print_config: bool,
    quiet: bool,
    verbose: bool,
    as_json: bool = False,
    opens: bool = False,
    **arguments: object,
) -> int:
    """Run the pipeline of a command with its config; return the exit code.

    With `print_config` the config is printed to stdout instead; `opens` opens what was written in a
    browser; `as_json` prints what was done. Raises InputError on a
    wrong config.
    """
    # No plug-in changes the schema, and looking for them in all installed packages takes long.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    from shapefit.config import dump_config, find_config, load_config
    from shapefit.config.paths import STANDARD_STREAM, ResultFolder

    file = find_config(spec.name, Path(config_path) if config_path else None)
    config = load_config(spec.name, file, overrides, arguments, to_show=print_config)
    if print_config:
        click.echo(dump_config(config), nl=False)
        return 0
    if verbose and file is not None:
        tell(f"Config: {file.path}")
    in_parts = isinstance(getattr(config, "output", None), ResultFolder)
    name = spec.in_parts if in_parts else spec.pipeline
    pipeline = importlib.import_module(f"shapefit.pipelines.{name}").run
    if not gc.isenabled():
        gc.freeze()  # or the first look for cycles goes through all that was imported
        gc.enable()
    if as_json and getattr(config, "output", None) == STANDARD_STREAM:
        raise click.UsageError("--json and the output both go to stdout; name a file as output")
    prints_note = spec.prints_note and not as_json
    most = getattr(config, "fail_untrusted", None)
    report = Report(spec.name, spec.unit, quiet, verbose, prints_note, as_json, most)
    code = report.follow(pipeline(config))
    if opens:
        _open_in_browser(report.written)
    return code


def _open_in_browser(paths: Sequence[Path]) -> None:
    import webbrowser

    for path in paths:
        if not webbrowser.open(path.resolve().as_uri()):
            tell(f"No browser was found; open {path} in one.")
