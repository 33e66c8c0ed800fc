"""Write docs/config.md from the schema and docs/commands.md from the help.

`python tools/generate.py` (`make docs`) writes them; a test checks that they are in step.
"""

from __future__ import annotations

from pathlib import Path

import click
from shapefit.cli.main import commands

from shapefit.config.reference import reference_page

DOCS = Path(__file__).resolve().parents[1] / "docs"
WIDTH = 90


def pages() -> dict[Path, str]:
    """Return what each generated page has to say."""
    return {DOCS / "config.md": reference_page(), DOCS / "commands.md": commands_page()}


def commands_page() -> str:
    """Return the help of every command, as Markdown."""
    context = _context(commands, "shapefit")
    sections = ["# Commands\n", _help(context)]
    for name, command in commands.commands.items():
        sections += [f"## `{name}`\n", _help(_context(command, name, context))]
    return "\n".join(sections)


def _context(
    command: click.Command, name: str, parent: click.Context | None = None
) -> click.Context:
    return command.make_context(
        name, [], parent=parent, terminal_width=WIDTH, resilient_parsing=True
    )


def _help(context: click.Context) -> str:
    return f"```\n{context.get_help()}\n```\n"


def main() -> None:
    """Write the pages."""
    for path, text in pages().items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
