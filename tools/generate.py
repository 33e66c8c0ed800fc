"""Write docs/config.md from the schema, docs/commands.md from the help, and the core's
stub.

`python tools/generate.py` (`make docs`) writes them; tests check that they are in step.
"""

from __future__ import annotations

from collections.abc import Iterable
from copy import copy
from pathlib import Path

import click
from nanobind.stubgen import StubGen
from pydantic import BaseModel
from shapefit.cli.main import commands
from shapefit.cli.options import COMMON

from shapefit import core
from shapefit.config import CONFIGS
from shapefit.config.commands.input import LandmarksConfig, MetresConfig, TruthConfig
from shapefit.config.reference import KeyInWords, describe_keys

DOCS = Path(__file__).resolve().parents[1] / "docs"
WIDTH = 90

KEYS = """\
# Config keys

Each command reads one YAML file (`-c`), in YAML 1.2: `1e-3` is a number and `no` is a \
string. `--set key=value` and `--set key.key=value` override the file; options \
override both.

- Paths in a file are relative to the file, paths on the command line to the working
  directory.
- A path to read may be a glob (`*`, `?`, `[...]`, `**`); it must match at least one
  file.
- `-` is standard input or output, as CSV.
- A path may begin with `{data}`, which stands for the folder that the key `data`
  names. Every command has this key.
- `-c NAME` is an installed config: `-c cars` of `fit` is `configs/cars/fit.yaml`. An
  existing file of that name is preferred. Keys that apply only to its own data are
  ignored: paths, `leave_one_out`, `camera.principal_point`, `match`, `groups` and
  `truth_frame`.
- `-d NAME`, or `dictionary: NAME` in a file, is an installed dictionary, such as
  `people`. An existing file of that name is preferred.
- `--print-config` prints the config with every default; `shapefit config COMMAND`
  prints its keys.
"""

SHARED: dict[str, type[BaseModel]] = {
    "Reading landmarks": LandmarksConfig,
    "Writing metres": MetresConfig,
    "Comparing with the truth": TruthConfig,
}
"""Keys of several commands, which the page lists once."""

STUB = """\
\"\"\"Signatures of the extension module, written by tools/generate.py.\"\"\"

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]
States = NDArray[np.uint64]

IMAGES_PER_BLOCK: int
"""


def pages() -> dict[Path, str]:
    """Return path -> text of the generated pages of docs/."""
    return {DOCS / "config.md": config_page(), DOCS / "commands.md": commands_page()}


def stub() -> str:
    """Return the text of the stub of the compiled core: the signature of each function
    on a line.
    """
    generator = StubGen(core._core, recursive=False)  # type: ignore[attr-defined]
    generator.put(core._core)  # type: ignore[attr-defined]
    functions = [
        line for line in generator.get().splitlines() if line.startswith("def ")
    ]
    return "\n".join([STUB, *functions, ""])


def config_page() -> str:
    """Return the page of the config keys of all commands, as Markdown."""
    sections, listed = [KEYS], dict[type[BaseModel], set[str]]()
    for title, model in SHARED.items():
        above = set().union(*(listed[base] for base in model.__mro__ if base in listed))
        users = [
            f"`{name}`" for name, config in CONFIGS.items() if issubclass(config, model)
        ]
        shared = [row for row in describe_keys(model) if row.name not in above]
        sections.append(f"## {title}: {', '.join(users)}\n\n{_table_of_keys(shared)}")
        listed[model] = above | {row.name for row in shared}
    for command, config in CONFIGS.items():
        above = set().union(
            *(listed[base] for base in config.__mro__ if base in listed)
        )
        others = [row for row in describe_keys(config) if row.name not in above]
        summary = " ".join((config.__doc__ or "").split())
        sections.append(f"## `{command}`\n\n{summary}\n\n{_table_of_keys(others)}")
    return "\n".join(sections)


def _table_of_keys(shown: Iterable[KeyInWords]) -> str:
    lines = (
        f"| `{row.name}` | {row.expects} | `{row.default}` | {row.meaning} |"
        for row in shown
    )
    return "\n".join(
        ["| key | expects | default | meaning |", "|---|---|---|---|", *lines, ""]
    )


def commands_page() -> str:
    """Return the help of every command, as Markdown; their common options once."""
    context = _context_of(commands, "shapefit")
    sections = ["# Commands\n", _help_as_markdown(context)]
    fit = copy(commands.commands["fit"])
    fit.params = [option for option in fit.params if option.name in COMMON]
    options = (
        _help_as_markdown(_context_of(fit, "fit", context))
        .partition("Options:")[2]
        .partition("\n\n")[0]
    )
    sections += [f"## Options of every command\n\n```{options}\n```\n"]
    for name, command in commands.commands.items():
        other = copy(command)
        other.params = [
            option for option in command.params if option.name not in COMMON
        ]
        text = _help_as_markdown(_context_of(other, name, context))
        sections += [f"## `{name}`\n", text]
    return "\n".join(sections)


def _context_of(
    command: click.Command, name: str, parent: click.Context | None = None
) -> click.Context:
    return command.make_context(
        name, [], parent=parent, terminal_width=WIDTH, resilient_parsing=True
    )


def _help_as_markdown(context: click.Context) -> str:
    return f"```\n{context.get_help()}\n```\n"


def main() -> None:
    """Write the generated pages of docs/ and the stub of the core."""
    stub_path = DOCS.parent / "shapefit/core/_core.pyi"
    for path, text in (*pages().items(), (stub_path, stub())):
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
