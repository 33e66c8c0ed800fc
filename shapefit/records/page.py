"""Page: what `Fit.view` returns."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from os import PathLike
from pathlib import Path


@dataclass(frozen=True, repr=False)
class Page:
    """An HTML page, which a notebook shows in a frame of its own.

    Attributes
    ----------
    html : str
        The page, which needs no other file.
    path : Path
        Where it is saved, None if it is not.
    height : int
        Of the frame, in pixels.

    """

    html: str
    path: Path | None = None
    height: int = 620

    def _repr_html_(self) -> str:
        # the page's scripts reach neither the notebook nor its files
        style = f"border:0;width:100%;height:{self.height}px"
        frame = f'<iframe sandbox="allow-scripts" style="{style}"'
        return f'{frame} srcdoc="{escape(self.html)}"></iframe>'

    def __repr__(self) -> str:
        place = "not saved" if self.path is None else str(self.path)
        return f"<shapefit.Page: {len(self.html) / 1e6:.1f} MB, {place}>"

    def save(self, path: str | PathLike[str]) -> Page:
        """Write the page to a file.

        Parameters
        ----------
        path : path
            HTML file to write.

        Returns
        -------
        Page
            The same, with its path.

        """
        Path(path).write_text(self.html, encoding="utf-8")
        return Page(self.html, Path(path), self.height)
