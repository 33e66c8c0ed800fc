"""Fit: the shapes of images, with what a method knows of them."""

# No `from __future__ import annotations` here: `columns_of` reads what stands beside
# the fields.

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from importlib import import_module
from os import PathLike
from typing import TYPE_CHECKING, Annotated, ClassVar, Self

import numpy as np

from shapefit.arrays import Flags, Floats, Integers
from shapefit.errors import counted
from shapefit.records.columns import (
    LENGTH,
    Named,
    Rows,
    Singles,
    Texts,
    Unit,
    Words,
)
from shapefit.records.items import Direction, Items
from shapefit.records.shapes import Shapes

if TYPE_CHECKING:
    import pandas
    import xarray
    from mpl_toolkits.mplot3d import Axes3D

    from shapefit.geometry.cameras import Up
    from shapefit.records.page import Page


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Fit(Items):
    """3D shapes of n images, in the camera frame and the unit of the landmarks.

    None is what the method does not know.
    """

    POINTS: ClassVar[str] = "shapes"

    shapes: Annotated[Floats, "n p 3", LENGTH]
    """Positions, NaN where there is no shape."""
    _: KW_ONLY
    status: Annotated[Words | None, "n"] = None
    """How the solver ended."""
    rotation: Annotated[Floats | None, "n 3 3"] = None
    """R, from object to camera."""
    translation: Annotated[Floats | None, "n 2", LENGTH] = None
    """T, where the middle of the shape is seen."""
    scale: Annotated[Floats | None, "n", LENGTH] = None
    """Size of the normalised landmarks and shapes."""
    objective: Annotated[Floats | None, "n"] = None
    """Value of the method's program."""
    iterations: Annotated[Integers | None, "n"] = None
    """Steps of the solver."""
    residual: Annotated[Floats | None, "n"] = None
    """Share of the landmarks that is not explained."""
    lam: Annotated[Floats | None, "n", Named("lambda")] = None
    """Weight of the spectral norms."""
    metres_per_unit: Annotated[Floats | None, "n", Unit("m")] = None
    """Metres in a unit of the shape, by the training shapes."""
    stated_height: Annotated[Floats | None, "n", Unit("m")] = None
    """Height from head to foot that `fit` was told."""
    omitted: Annotated[Words | None, "n"] = None
    """Item of the dictionary that the fit did without, or empty."""

    landmarks: Annotated[Floats | None, "n p 2", LENGTH] = None
    """Landmarks that were lifted, NaN where unseen."""
    confidence: Annotated[Floats | None, "n p"] = None
    """Weights of the landmarks as the files had them."""
    outliers: Annotated[Flags | None, "n p"] = None
    """Landmarks that the fit set aside."""
    landmarks_fitted: Annotated[Floats | None, "n p 2", LENGTH] = None
    """Projections of the shapes; without them x and y of these."""
    focal: Annotated[Floats | None, "n 2", Unit("px")] = None
    """Focal lengths of a perspective camera."""
    principal_point: Annotated[Floats | None, "n 2", Unit("px")] = None
    """Where its optical axis meets the image."""
    camera_translation: Annotated[Floats | None, "n 3"] = None
    """Origin of the shape before it, in sizes of the shape."""
    position: Annotated[Floats | None, "n 3", Unit("unit of the atoms")] = None
    """Object before it, where the dictionary knows sizes."""

    coefficients: Annotated[Floats | None, "n k"] = None
    """c, the spectral norms of the transforms of the atoms."""
    relative_gap: Annotated[Floats | None, "n"] = None
    """Duality gap of the objective, as a share of it."""
    active_atoms: Annotated[Integers | None, "n"] = None
    """Number of atoms with a coefficient."""
    tight: Annotated[Flags | None, "n"] = None
    """Whether all transforms have orthogonal rows."""
    dual: Annotated[Floats | None, "n p 2"] = None
    """Feasible Y, which proves the bound."""
    convex_translation: Annotated[Floats | None, "n 2"] = None
    """T of the convex program."""
    convex_objective: Annotated[Floats | None, "n"] = None
    """Its value, where it is not the objective."""
    convex_relative_gap: Annotated[Floats | None, "n"] = None
    """Its gap, likewise."""
    transform_count: Annotated[Integers | None, "n"] = None
    """Number of transforms that are not 0."""
    transform_atom: Annotated[Integers | None, "a"] = None
    """Atom of each of these."""
    active_transforms: Annotated[Floats | None, "a 2 3"] = None
    """M_i, one image after the other."""
    transforms: Annotated[Floats | None, "n k 2 3"] = None
    """M_i of all atoms, as earlier versions wrote them."""

    shape_sd: Annotated[Floats | None, "n p 3", LENGTH] = None
    """Standard deviations of the coordinates."""
    shape_correlation: Annotated[Singles | None, "n p 3"] = None
    """Correlations of x with y, x with z, y with z."""
    shape_covariance: Annotated[Floats | None, "n r r"] = None
    """Covariances of all coordinates, landmark by landmark."""
    log_evidence: Annotated[Floats | None, "n"] = None
    """log p(w), the probability of the landmarks under the prior."""
    inlier_probability: Annotated[Floats | None, "n p"] = None
    """Probability that a landmark is no outlier, NaN where unseen."""
    p_value: Annotated[Floats | None, "n"] = None
    """Plausibility of the landmarks under the prior."""
    start_distance: Annotated[Floats | None, "n"] = None
    """Distance from the shape of the convex program, in sizes of the shape."""
    expected_error: Annotated[Floats | None, "n", LENGTH] = None
    """Mean distance of the landmarks from the truth that is expected."""
    image_error: Annotated[Floats | None, "n"] = None
    """Error that is expected of the image alone, in sizes of the shape."""
    sequence_noise: Annotated[Floats | None, "n"] = None
    """Noise of the landmarks of the sequence, in sizes of the shape."""
    sides_exchanged: Annotated[Floats | None, "n"] = None
    """1 where left and right were exchanged, NaN where nobody knows."""
    trusted: Annotated[Flags | None, "n"] = None
    """Whether no reason speaks against the shape."""
    reasons: Annotated[Words | None, "n"] = None
    """Reason not to trust it, or empty."""

    input_landmark_names: Annotated[Texts | None, "i"] = None
    """Names of a detector's landmarks, where these are not the joints."""
    input_shapes: Annotated[Floats | None, "n i 3", LENGTH] = None
    """Their positions in 3D."""
    input_shape_sd: Annotated[Floats | None, "n i 3", LENGTH] = None
    """Their standard deviations."""
    input_shape_correlation: Annotated[Singles | None, "n i 3"] = None
    """Their correlations of x with y, x with z, y with z."""
    landmark_map: Annotated[Floats | None, "p p"] = None
    """A, by which landmarks follow from joints, as earlier versions wrote it."""
    mesh_vertices: Annotated[Floats | None, "n q 3", LENGTH] = None
    """Vertices of a mesh, as earlier versions wrote them."""

    failures: Mapping[str, str] = field(default_factory=dict)
    """Images without a shape, and why; not stored in files."""
    y_axis: Direction = "down"
    """Where y points."""

    @classmethod
    def of_shapes(cls, shapes: Shapes) -> Self:
        """Return shapes from elsewhere as a fit of which nothing else is known."""
        return cls(
            shapes.shapes,
            landmark_names=shapes.landmark_names,
            items=shapes.items,
            sequences=shapes.sequences,
            frames=shapes.frames,
            times=shapes.times,
            unit=shapes.unit,
            frame_rate=shapes.frame_rate,
        )

    def take(self, rows: Rows) -> Self:
        """Return some images, in the order of `rows`; a slice copies nothing."""
        part = Items.take(self, rows)
        if not self.failures:
            return part
        here = set(part.items)
        failures = {item: why for item, why in self.failures.items() if item in here}
        return part.replaced(failures=failures)

    def __repr__(self) -> str:
        parts = [
            counted(len(self), "image"),
            counted(self.shapes.shape[1], "landmark"),
        ]
        if "method" in self.attributes:
            parts.append(f"method {self.attributes['method']}")
        if self.failures:
            parts.append(f"{len(self.failures)} failed")
        if self.trusted is not None:
            parts.append(f"{int(self.trusted.sum())} trusted")
        return f"<shapefit.Fit: {', '.join(parts)}, in {self.unit}>"

    # How a fit is shown and handed on is known above this room, which is imported by
    # its name.

    def to_metres(
        self,
        *,
        height: float | None = None,
        unit: str | None = None,
        up: "Up | None" = None,
    ) -> "np.recarray[tuple[int], np.dtype[np.void]]":
        """Return joints in metres, as `convert -o x.metres.csv` writes them.

        Parameters
        ----------
        height : float
            Of the body in metres; by default that of the fit.
        unit : str
            Unit of the shapes where they do not state it.
        up : str
            Axis of the world of a calibrated camera that points up, such as "z".

        Returns
        -------
        recarray
            A row per frame and landmark: frame, time (s, or frames without a frame
            rate), landmark, x, y, z, sd of the distance to the point, trusted,
            sequence; NaN in gaps.

        Raises
        ------
        InputError
            Where nothing says how large the shapes are.

        """
        tables = import_module("shapefit.api.tables")
        table: np.recarray[tuple[int], np.dtype[np.void]]
        table = tables.to_metres(self, height=height, unit=unit, up=up)
        return table

    @property
    def metres(self) -> "np.recarray[tuple[int], np.dtype[np.void]]":
        """Joints in metres, as `to_metres` returns them."""
        return self.to_metres()

    def to_pandas(self) -> "pandas.DataFrame":
        """Return a table with a row per landmark and image.

        Returns
        -------
        pandas.DataFrame
            item, landmark, x, y, z, and what the fit knows of sd_x, sd_y, sd_z, frame,
            time (s, or frames without a frame rate), sequence, trusted, reasons. Every
            command reads the CSV that its `to_csv` writes.

        """
        table: pandas.DataFrame = import_module("shapefit.api.tables").to_pandas(self)
        return table

    def to_xarray(self) -> "xarray.Dataset":
        """Return a dataset with the axes item, landmark and space.

        Returns
        -------
        xarray.Dataset
            All fields that belong to images, or to landmarks of images, in the unit of
            the landmarks; `plane` is the axis of points in the image.

        """
        dataset: xarray.Dataset = import_module("shapefit.api.tables").to_xarray(self)
        return dataset

    def plot(self, image: int | str = 0, ax: "Axes3D | None" = None) -> "Axes3D":
        """Draw the shape of one image, with a bar of one standard deviation each way.

        Parameters
        ----------
        image : int or str
            Number or name of the image.
        ax : axes of matplotlib
            Axes in 3D to draw into; by default new ones.

        Returns
        -------
        axes of matplotlib

        """
        axes: Axes3D = import_module("shapefit.api.notebook").plot(self, image, ax)
        return axes

    def view(
        self, output: str | PathLike[str] | None = None, *, open: bool = False
    ) -> "Page":
        """Make the page of `shapefit view`, to rotate and play.

        Parameters
        ----------
        output : path
            HTML file to write; by default none is written.
        open : bool
            Show that file in a browser.

        Returns
        -------
        Page
            A notebook shows it at the end of a cell.

        """
        notebook = import_module("shapefit.api.notebook")
        page: Page = notebook.view(self, output, open=open)
        return page

    def _repr_html_(self) -> str:
        html: str = import_module("shapefit.api.notebook").as_html(self)
        return html
