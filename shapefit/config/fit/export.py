"""The sections `export` and `pictures` of `fit`: what can be opened and looked at."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, ValidationInfo, field_validator

from shapefit.config.model import ConfigModel, FromLists
from shapefit.config.paths import OF_THE_DATA, Folder

Items = Annotated[tuple[str, ...], FromLists, OF_THE_DATA]

MOST_ON_A_SHEET = 200
"""More would be too small to see, or too large to open."""


class _FilesConfig(ConfigModel):
    """Files of a fit, written where there is a folder for them."""

    folder: Folder = None

    @field_validator("*")
    @classmethod
    def _has_an_effect(cls, value: Any, info: ValidationInfo) -> Any:
        key = str(info.field_name)
        if value != cls.model_fields[key].default and info.data.get("folder", value) is None:
            raise ValueError(f"`{key}` does nothing without `folder`; give one, or leave {key} out")
        return value


class ExportConfig(_FilesConfig):
    """Mesh files of the fitted shapes, one per image."""

    folder: Folder = None
    """Folder to write mesh files to; none writes none."""
    format: Literal["obj", "ply", "ply-ascii", "glb"] = "ply"
    """Format of the files; ply is binary."""
    frame: Literal["object", "camera"] = "object"
    """Frame of the vertices: that of the dictionary, in which objects are oriented like its
    training shapes; or the camera's, in which y points as in the landmarks."""
    unit: Literal["landmarks", "dictionary"] = "landmarks"
    """Unit of the vertices: that of the landmarks (pixels), or that of the dictionary (metres), in
    which the size is the mean over the atoms used."""
    landmarks: bool = False
    """Also write the landmarks, as a second object."""
    wireframe: Literal["tubes", "lines"] = "tubes"
    """How edges between fitted landmarks are written if the dictionary has no mesh."""
    items: Items = ("*",)
    """Items to write: names or globs."""


class PicturesConfig(_FilesConfig):
    """Pictures of landmarks, fitted model and novel views."""

    folder: Folder = None
    """Folder to write pictures to; none writes none."""
    format: Literal["png", "svg"] = "png"
    """Format of the pictures."""
    items: Items = ("*",)
    """Items to draw a picture of: names or globs."""
    most: int = Field(default=20, ge=0)
    """Maximum number of pictures; the first matches are drawn."""
    sheet: int = Field(default=0, ge=0, le=MOST_ON_A_SHEET)
    """Number of images on the contact sheet, spread evenly over all; 0 draws none."""
