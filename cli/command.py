"""A click command made from a row of the table: its config, pipeline and report."""

from __future__ import annotations

import gc
import importlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from .commands import Spec
from .options import config_options, identifier, reporting_options
from .report import Report
from .streams import tell


def make_command(spec: Spec) -> click.Command:
    """Return the click command of a row of the table."""
    key, metavar = spec.inputs
    examples = "\n".join(f"  {line}" for line in spec.examples)
    return click.Command(
        spec.name,
        callback=lambda **values: run_command(spec, **values),
        params=[
            click.Argument([identifier(key)], nargs=-1, metavar=metavar),
            *(each.option for each in spec.options),
            *config_options(spec.name),
            *reporting_options(),
        ],
        short_help=spec.summary,
        help=spec.text,
        epilog=f"\b\nExamples:\n{examples}\n",
    )


def run_command(
    spec: Spec,
    *,
    config_path: str | None,
    overrides: Sequence[str],
    print_config: bool,
    quiet: bool,
    verbose: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Run the pipeline of a command with its config; return the exit code.

    With `print_config` the config is printed to stdout instead. Raises InputError on a wrong
    config, and click.UsageError where an argument is missing.
    """
    # No plug-in changes the schema, and looking for them in all installed packages takes long.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    from shapefit.config import dump_config, find_config, load_config
    from shapefit.config.paths import STANDARD_STREAM, ResultFolder

    keys = (spec.inputs[0], *(each.key for each in spec.options))
    arguments = {key: options[identifier(key)] for key in keys}
    opens = arguments.pop("opens", None)
    if config_path is None and not print_config:
        check_required(spec, arguments, overrides)
    file = find_config(spec.name, Path(config_path) if config_path else None)
    config = load_config(spec.name, file, overrides, arguments, to_show=print_config)
    if print_config:
        click.echo(dump_config(config), nl=False)
        return 0
    if verbose and file is not None:
        tell(f"Config: {file.path}")
    output = getattr(config, "output", None)
    if as_json and output == STANDARD_STREAM:
        raise click.UsageError("--json and the output both go to stdout; name a file as output")
    name = spec.in_parts if isinstance(output, ResultFolder) else spec.pipeline
    pipeline = importlib.import_module(f"shapefit.pipelines.{name}").run
    if not gc.isenabled():
        gc.freeze()  # or the first look for cycles goes through all that was imported
        gc.enable()
    most = getattr(config, "fail_untrusted", None)
    report = Report(spec.name, spec.unit, quiet, verbose, spec.prints_note, as_json, most)
    code = report.follow(pipeline(config))
    if opens:
        _open_in_browser(report.written)
    return code


def check_required(spec: Spec, arguments: Mapping[str, Any], overrides: Sequence[str]) -> None:
    """Raise click's error, with an example, where an argument that is needed is missing."""
    context = click.get_current_context()
    parameters = {each.name: each for each in context.command.params}
    given = {override.partition("=")[0].strip() for override in overrides}
    for key in spec.required:
        if not arguments[key] and key not in given:
            example = f"For example: {spec.examples[0]}"
            parameter = parameters[identifier(key)]
            raise click.MissingParameter(example, context, parameter)


def _open_in_browser(paths: Sequence[Path]) -> None:
    import webbrowser

    for path in paths:
        if not webbrowser.open(path.resolve().as_uri()):
            tell(f"No browser was found; open {path} in one.")
