"""A click command made from a row of the table: its config, pipeline and report."""

from __future__ import annotations

import gc
import importlib
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import click

from .commands import Spec
from .options import config_options, reporting_options
from .report import Report
from .streams import tell


class ConfigCommand(click.Command):
    """A command with a config: an unknown option that is a key of it is an error with the fix."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments; raise NoSuchOption with a hint."""
        given = list(args)
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            hint = _set_hint(str(self.name), error.option_name, given)
            if hint is None:
                raise
            message = f"No such option: {error.option_name}; it is a key of the config: {hint}"
            raise click.NoSuchOption(error.option_name, message, ctx=ctx) from None


def make_command(spec: Spec) -> click.Command:
    """Return the click command of a row of the table."""
    files, *further = spec.parameters
    return ConfigCommand(
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
    fail_untrusted: float | None = None,
    markers: str | None = None,
    **arguments: object,
) -> int:
    """Run the pipeline of a command with its config; return the exit code.

    With `print_config` the config is printed to stdout instead; `opens` opens what was written in a
    browser; `as_json` prints what was done; `markers` goes to the pipeline. Raises InputError on a
    wrong config.
    """
    # No plug-in changes the schema, and looking for them in all installed packages takes long.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    from shapefit.config import dump_config, find_config, load_config
    from shapefit.config.paths import STANDARD_STREAM, ResultFolder

    file = find_config(spec.name, Path(config_path) if config_path else None)
    chooses = file is None and bool(spec.chooser)
    given: tuple[Sequence[str], Mapping[str, object]] = (overrides, arguments)
    config = load_config(spec.name, file, *given, to_show=print_config, final=not chooses)
    if chooses:
        chooser = importlib.import_module(f"shapefit.pipelines.{spec.chooser}")
        default = chooser.choose_default(config)
        line = ""
        if default.config is not None:
            file = find_config(spec.name, Path(default.config))
            line = f"Config: {default.config}, which suits the dictionary; -c names another."
        elif default.method is not None:
            given = ([f"method={default.method}", *overrides], arguments)
            line = f"Method: {default.method}, for the dictionary has a prior over shapes; "
            line += "`--set method=convex` does without."
        config = load_config(spec.name, file, *given, to_show=print_config)
        if line and not quiet:
            tell(line)
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
    if in_parts and markers is not None:
        raise click.UsageError("--markers is for one output in metres, and the output is a folder")
    if as_json and getattr(config, "output", None) == STANDARD_STREAM:
        raise click.UsageError("--json and the output both go to stdout; name a file as output")
    prints_note = spec.prints_note and not as_json
    report = Report(spec.name, spec.unit, quiet, verbose, prints_note, as_json, fail_untrusted)
    further = {} if markers is None else {"markers": markers}
    code = report.follow(pipeline(config, **further))
    if opens:
        _open_in_browser(report.written)
    return code


def _open_in_browser(paths: Sequence[Path]) -> None:
    import webbrowser

    for path in paths:
        if not webbrowser.open(path.resolve().as_uri()):
            tell(f"No browser was found; open {path} in one.")


def _set_hint(command: str, option: str, given: Sequence[str]) -> str | None:
    """Return `--set key=value` for an option that is a key of the config; None for any other."""
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    from shapefit.config import CONFIGS
    from shapefit.config.model import dotted_keys

    words = re.sub(r"[-_]", "_", option.lstrip("-"))
    keys = [key for key in dotted_keys(CONFIGS[command]) if "-" not in key]
    matches = [key for key in keys if key == words]
    matches = matches or [key for key in keys if key.rpartition(".")[2] == words]
    if not matches:
        return None
    value = "VALUE"
    for argument, following in zip(given, [*given[1:], "--"], strict=True):
        name, equals, text = argument.partition("=")
        if name == option and (equals or not following.startswith("--")):
            value = text if equals else following
    return " or ".join(f"--set {key}={value}" for key in matches)
