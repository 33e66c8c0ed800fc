"""One call of a command: its config, and the report of its pipeline."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click

from .report import Report, tell
from .values import key_path, keys_of

if TYPE_CHECKING:
    from shapefit.config import CommandConfig
    from shapefit.pipelines.result import Result

TRACEBACK_VARIABLE = "SHAPEFIT_TRACEBACK"

Config = TypeVar("Config", bound="CommandConfig")


@dataclass(kw_only=True, eq=False, repr=False)
class Call:
    """A command that was called, and the options that all commands have.

    `needs` are the parameters without which it does nothing. Raises click.UsageError
    for options that exclude each other.
    """

    command: str
    example: str
    needs: Sequence[str] = ()
    config: str | None = None
    settings: Sequence[str] = ()
    print_config: bool = False
    as_json: bool = False
    quiet: bool = False
    verbose: bool = False
    traceback: bool = False

    def __post_init__(self) -> None:
        if self.traceback:
            os.environ[TRACEBACK_VARIABLE] = "1"
        if self.quiet and self.verbose:
            raise click.UsageError("-q and -v exclude each other; give one of them")

    def check_needed_parameters(self, keys: Mapping[str, object]) -> None:
        """Raise click.MissingParameter, with an example, where a needed one is absent.

        A config file, and --set, may have it.
        """
        if self.config is not None or self.print_config:
            return
        in_settings = {setting.partition("=")[0].strip() for setting in self.settings}
        for name in self.needs:
            if not keys[name] and name not in in_settings:
                context = click.get_current_context()
                parameters = {given.name: given for given in context.command.params}
                example = f"For example: {self.example}"
                raise click.MissingParameter(example, context, parameters[name])

    def read_config(self, schema: type[Config], keys: Mapping[str, object]) -> Config:
        """Load the config from its file, --set and the options `keys` (a__b is a.b).

        With --print-config it is printed, and the command ends. Raises InputError with
        all that is wrong with it.
        """
        from shapefit.config import dump_config, load_config

        arguments = {".".join(key_path(name)): keys[name] for name in keys}
        missing = {name: None for name in (*self.needs, "output") if name in keys}
        config = load_config(
            self.command,
            Path(self.config) if self.config else None,
            self.settings,
            arguments,
            placeholders=missing if self.print_config else None,
        )
        assert isinstance(config, schema)
        if self.print_config:
            click.echo(dump_config(config), nl=False)
            raise click.exceptions.Exit(0)
        if self.as_json and getattr(config, "output", None) == Path("-"):
            raise click.UsageError(
                "--json and the output both go to stdout; name a file as output"
            )
        return config

    def reword(self, text: str) -> str:
        """Return a message that names options of the command instead of config keys.

        Where a config file was given, only a key at its beginning is replaced.
        """
        from .wording import name_options, options_of_keys, place_in_options

        options = options_of_keys(click.get_current_context().command)
        if self.config is not None or "`" not in text:
            return place_in_options(text, options)
        keys = [".".join(path) for path in keys_of(self.command)]
        return name_options(text, options, keys)

    def follow(
        self,
        results: Iterator[Result],
        unit: str,
        *,
        read: str = "",
        next_command: str = "",
        to_stdout: bool = False,
        max_untrusted: float | None = None,
        show: bool = False,
    ) -> int:
        """Run a pipeline to its end and report it; return the exit code.

        `unit` is what its progress counts; with `show` what it wrote is opened in a
        browser. For the others see Report.
        """
        gc.freeze()  # or the first look for cycles goes through all that was imported
        gc.enable()
        report = Report(
            self.command,
            unit,
            quiet=self.quiet,
            verbose=self.verbose,
            to_stdout=to_stdout,
            as_json=self.as_json,
            max_untrusted=max_untrusted,
            read=read,
            next_command=next_command,
            reword=self.reword,
        )
        code = report.follow(results)
        for path in report.written if show else ():
            open_in_browser(path)
        return code


def open_in_browser(page: Path) -> None:
    """Show a page in a browser, or say that there is none."""
    import webbrowser

    if not webbrowser.open(page.resolve().as_uri()):
        tell(f"No browser was found; open {page} in one.")
