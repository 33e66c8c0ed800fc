"""The datasets of each kind of file: names, axes and types, once for reader and writer."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Literal, NamedTuple

Axes = tuple[str | int, ...]


class Column(NamedTuple):
    """One dataset.

    axes        as in the file: letters for sizes that agree over the file (AXES), or numbers
    kind        a label is text or an integer code
    points      coordinates, one point per row in the file (..., p, 3), per column in memory
                (..., 3, p)
    counted_by  the dataset that holds how many rows of this one belong to each item
    stored      NumPy type in the file where it is smaller than in memory
    """

    axes: Axes
    kind: Literal["number", "index", "text", "label"] = "number"
    required: bool = False
    points: bool = False
    counted_by: str = ""
    stored: str = ""

    @property
    def per_item(self) -> bool:
        """Whether it gets longer with more items."""
        return self.axes[0] == "n" or bool(self.counted_by)


Table = Mapping[str, Column]


class Layout(NamedTuple):
    """The datasets of one kind of file.

    name is the root attribute `format`, points the dataset that every file has; `further` may stand
    beside `datasets`, and are in memory as in the file.
    """

    name: str
    points: str
    datasets: Table
    further: Table

    @property
    def kind(self) -> str:
        """The name without `shapefit-`."""
        return self.name.removeprefix("shapefit-")

    @property
    def all(self) -> Table:
        """All datasets that it lists."""
        return {**self.datasets, **self.further}

    def is_per_item(self, name: str, axes: int) -> bool:
        """Whether a dataset with so many axes has rows for items, unless its file states it."""
        column = self.all.get(name)
        return 0 < axes != OF_FILE.get(name) if column is None else column.per_item


VERSION = 2
UNKNOWN_UNIT = "unknown"

PER_ITEM = "per_item"
"""Attribute of a dataset that no layout lists: whether it has a row for each item."""

RENAMED = {
    "belief": "inlier_probability",
    "doubt": "reasons",
    "edge_give": "bone_tolerance",
    "left_out": "omitted",
    "misfit": "residual_variance",
    "plausibility": "p_value",
}
"""Datasets of version 1 -> their names."""

FIELDS = {"item": "items", "sequence": "sequences", "atom_item": "atom_items"}
"""Fields of records that are not called as their datasets."""

AXES = {
    "n": "items",
    "p": "landmarks",
    "q": "mesh vertices",
    "k": "atoms",
    "e": "edges",
    "f": "faces",
    "t": "half-steps",
    "c": "components",
    "a": "active transforms",
    "w": "scales and numbers of landmarks",
    "i": "landmarks of the detector",
    "r": "coordinates of all landmarks",
}

OF_FILE = {
    "camera_matrix": 2,
    "distortion": 1,
    "removed_distortion": 1,
    "image_size": 1,
    "extrinsic_rotation": 2,
    "extrinsic_translation": 1,
    "edges": 2,
    "mirror_index": 1,
}
"""Datasets that no layout lists and that belong to the file when they have so many axes."""

EDGES = "edges"  # (e, 2) of landmarks and results: pairs of landmarks that a line joins
FRAME = "frame"  # (n,): the place of each item in its video, from 0
LANDMARK_COVARIANCE = "landmark_covariance"  # (n, p, 2, 2) in the unit of the landmarks squared
LABELS = OUTLIERS, CORRUPTED = "outliers", "corrupted"
"""Datasets (n, p) of the landmarks that a fit calls outliers, and of those that were made so."""

METRES_PER_UNIT = "metres_per_unit"  # (n,) of results: metres in one unit of the shape of an image
METRES_FROM = "metres_from"  # attribute: by what that size was found, edges or spread

INPUT_SHAPES, INPUT_SD = "input_shapes", "input_shape_sd"
INPUT_CORRELATION, INPUT_NAMES = "input_shape_correlation", "input_landmark_names"
"""Of a result: the landmarks of the files in 3D with their error bars, beside the joints."""


def _columns(axes: Axes, names: str, *, points: bool = False) -> dict[str, Column]:
    """Return columns of numbers with the same axes."""
    return {name: Column(axes, points=points) for name in names.split()}


_NAMES = {"landmark_names": Column(("p",), "text", required=True)}
_ITEMS = {
    **_NAMES,
    "item": Column(("n",), "text", required=True),
    "sequence": Column(("n",), "text"),
}
_FACES = {"mesh_faces": Column(("f", 3), "index")}
_EDGES = {EDGES: Column(("e", 2), "index")}
_VERTICES = _columns(("n", "q", 3), "mesh_vertices", points=True)
_SHAPES = {"shapes": Column(("n", "p", 3), required=True, points=True)}

LANDMARKS = Layout(
    "shapefit-landmarks",
    "landmarks",
    {
        **_ITEMS,
        "landmarks": Column(("n", "p", 2), required=True, points=True),
        "confidence": Column(("n", "p")),
    },
    {},
)

SHAPES = Layout(
    "shapefit-shapes", "shapes", {**_ITEMS, **_SHAPES, **_EDGES, **_VERTICES, **_FACES}, {}
)

PROOF = {
    "dual": Column(("n", "p", 2), points=True),
    "convex_translation": Column(("n", 2)),
    **_columns(("n",), "convex_objective convex_relative_gap"),
    "transform_count": Column(("n",), "index", stored="int32"),
    "transform_atom": Column(("a",), "index", counted_by="transform_count", stored="int32"),
    "active_transforms": Column(("a", 2, 3), counted_by="transform_count"),
}
"""What proves the optimum of the convex program of a result, beside its landmarks and lambda."""

RESULTS = Layout(
    "shapefit-result",
    "shapes",
    {
        **_ITEMS,
        **_SHAPES,
        **_columns(("n", "p", 2), "landmarks_fitted", points=True),
        **_columns(("n", "k"), "coefficients"),
        **_columns(("n", 3, 3), "rotation"),
        **_columns(("n", 2), "translation"),
        **_columns(("n",), "scale objective relative_gap"),
        "iterations": Column(("n",), "index"),
        "status": Column(("n",), "label"),
        **_columns(("n", "p", 3), "shape_sd", points=True),
        **_columns(("n", "k", 2, 3), "transforms"),
        **_VERTICES,
        **PROOF,
    },
    {
        **_columns(
            ("n",),
            "lambda residual active_atoms tight metres_per_unit log_evidence p_value trusted "
            "sequence_noise start_distance expected_error image_error sides_exchanged",
        ),
        **_columns(("n", 2), "focal principal_point"),
        **_columns(("n", 3), "camera_translation position"),
        **_columns(("n", "p"), "inlier_probability outliers"),
        **_columns(("n", "p", 2), "landmarks"),
        **_columns(("n", "p", 3), "shape_correlation"),
        **_columns(("n", "r", "r"), "shape_covariance"),
        **_columns(("n", "i", 3), f"{INPUT_SHAPES} {INPUT_SD} {INPUT_CORRELATION}"),
        **_columns(("p", "p"), "landmark_map"),
        **{name: Column(("n",), "text") for name in ("reasons", "omitted")},
        INPUT_NAMES: Column(("i",), "text"),
    },
)

DICTIONARY = Layout(
    "shapefit-dictionary",
    "atoms",
    {
        **_NAMES,
        "atoms": Column(("k", "p", 3), required=True, points=True),
        "mean_shape": Column(("p", 3), required=True, points=True),
        **_EDGES,
        "mirror_index": Column(("p",), "index"),
        **_columns(("k", "q", 3), "mesh_vertices", points=True),
        **_FACES,
        **_columns(("k",), "atom_scale"),
        "atom_item": Column(("k",), "text"),
        **_columns(("t",), "objective_trace"),
        **_columns(("p",), "acceleration"),
        **_columns(("e",), "bone_tolerance edge_length"),
        **_columns(("e", "e"), "edge_covariance"),
        **_columns((1,), "residual_variance"),
        **_columns(("w", 4), "p_value_table"),
        **_columns(("c",), "prior_weights"),
        **_columns(("c", "p", 3), "prior_means", points=True),
        **_columns(("c", "p", 3, "p", 3), "prior_covariances"),
    },
    {},
)

LAYOUTS = {layout.name: layout for layout in (LANDMARKS, SHAPES, RESULTS, DICTIONARY)}
"""The layouts by the attribute `format`."""


def fit_axes(axes: Axes, shape: tuple[int, ...], sizes: dict[str, int]) -> bool:
    """Whether a shape has these axes; sizes of letters that are new are added to `sizes`."""
    fitting = [
        (sizes.setdefault(axis, size) if isinstance(axis, str) else axis) == size
        for axis, size in zip(axes, shape, strict=False)
    ]
    return len(shape) == len(axes) and all(fitting)


def free_names(names: Iterable[str], taken: Collection[str]) -> dict[str, str]:
    """Return the name under which each dataset can stand in a file that has those in `taken`.

    `input_` is put before a name that is taken, or whose group is, until it is free.
    """
    names, free = list(names), {}
    for name in names:
        new = name
        while new.partition("/")[0] in taken or (new != name and new in names):
            new = f"input_{new}"
        free[name] = new
    return free
