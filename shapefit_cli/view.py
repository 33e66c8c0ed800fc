"""`shapefit view`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .command import run_command
from .options import common_options
from .streams import tell

if TYPE_CHECKING:
    from .report import Report


@click.command(
    "view",
    short_help="Show results on a page to rotate and play.",
    epilog="""\b
Examples:
  shapefit view result.h5
  shapefit view convex.h5 pmp.h5 --truth test.h5 -o page.html --open
  shapefit view cars.h5 --truth models.h5 --set match=true_model --set images=frames/
""",
)
@click.argument("files", nargs=-1, metavar="[RESULT|LANDMARKS|SHAPES]...")
@common_options
@click.option("-o", "--output", metavar="PAGE.html", help="HTML file to write.")
@click.option(
    "--truth", metavar="SHAPES", multiple=True, help="File of the true 3D shapes. Repeatable."
)
@click.option(
    "-d", "--dictionary", metavar="DICT.h5", help="Dictionary with the edges and meshes to draw."
)
@click.option("--open", "opens", is_flag=True, help="Open the page in a browser.")
def view(
    files: tuple[str, ...],
    truth: tuple[str, ...],
    dictionary: str | None,
    output: str | None,
    opens: bool,
    config_path: Path | None,
    overrides: tuple[str, ...],
    print_config: bool,
) -> int:
    """Write one HTML page that shows results, to rotate and play.

    The page needs no network and no server: send it to a colleague. On the left are the
    landmarks in the image, on the right the shapes in 3D, and below them a strip that shows where
    to look.
    """
    return run_command(
        "view",
        "view.run",
        unit="frame",
        config_path=config_path,
        overrides=overrides,
        print_config=print_config,
        arguments={"files": files, "truth": truth, "dictionary": dictionary, "output": output},
        afterwards=_open if opens else None,
    )


def _open(report: Report) -> None:
    """Open what was written in the browser of the user."""
    import webbrowser

    for path in report.written:
        if not webbrowser.open(path.resolve().as_uri()):
            tell(f"No browser was found; open {path} in one.")
