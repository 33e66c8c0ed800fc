"""The datasets of each kind of file: names, axes and types, once for reader and
writer.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple

Axes = tuple[str | int, ...]

VERSION = 2
UNKNOWN_UNIT = "unknown"

PER_ITEM = "per_item"
"""Attribute of a dataset that no layout lists: whether it has a row for each item."""

COUNTS = "transform_count"
"""The dataset that holds how many rows of those with the axis `a` belong to each item.
"""

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

OF_FILE = {
    **dict.fromkeys(("camera_matrix", "extrinsic_rotation", "edges"), 2),
    **dict.fromkeys(
        ("distortion", "removed_distortion", "image_size", "mirror_index"), 1
    ),
    "extrinsic_translation": 1,
}
"""Datasets that no layout lists and that belong to the file when they have so many
axes.
"""

EDGES = "edges"  # (e, 2) of landmarks and results: pairs of landmarks that a line joins
FRAME = "frame"  # (n,): the place of each item in its video; gaps are gaps
TIME = "time"  # (n,) in seconds, where the file states it, nan where it does not
LABELS = OUTLIERS, CORRUPTED = "outliers", "corrupted"
"""Datasets (n, p) of the landmarks that a fit calls outliers, and of those that were
made so.
"""

METRES_PER_UNIT = (  # (n,) of results: metres in one unit of the shape of an image
    "metres_per_unit"
)
METRES_FROM = "metres_from"  # attribute: by what that size was found, edges or spread

INPUT_SHAPES, INPUT_SD = "input_shapes", "input_shape_sd"
INPUT_CORRELATION, INPUT_NAMES = "input_shape_correlation", "input_landmark_names"
"""Of a result: the landmarks of the files in 3D with their error bars, beside the
joints.
"""


class Column(NamedTuple):
    """One dataset: its axes in the file, and what it holds.

    Axes are letters, for sizes that agree over the file, or numbers. Kinds are number,
    index, text, and points: coordinates, one point per row in the file (..., p, 3), per
    column in memory.
    """

    axes: Axes
    kind: str = "number"
    required: bool = False

    @property
    def per_item(self) -> bool:
        """Whether it gets longer with more items."""
        return self.axes[0] in ("n", "a")


class Layout(NamedTuple):
    """The datasets of one kind of file.

    name is the root attribute `format`, points the dataset that every file has;
    `further` may stand beside `datasets`, and are in memory as in the file.
    """

    name: str
    points: str
    datasets: Mapping[str, Column]
    further: Mapping[str, Column] = MappingProxyType({})

    @property
    def kind(self) -> str:
        """The name without `shapefit-`."""
        return self.name.removeprefix("shapefit-")

    @property
    def all(self) -> dict[str, Column]:
        """All datasets that it lists."""
        return {**self.datasets, **self.further}

    def is_per_item(self, name: str, axes: int) -> bool:
        """Whether a dataset with so many axes has rows for items, unless its file
        states it.
        """
        column = self.all.get(name)
        return 0 < axes != OF_FILE.get(name) if column is None else column.per_item


def _table(text: str) -> dict[str, Column]:
    """Return the columns of a text; a line has axes, kind, and names, with `!` where
    required.
    """
    table: dict[str, Column] = {}
    for line in text.strip().splitlines():
        letters, kind, *names = line.split()
        axes = tuple(
            int(axis) if axis.isdigit() else axis for axis in letters.split(",")
        )
        table |= {
            name.rstrip("!"): Column(axes, kind, name.endswith("!")) for name in names
        }
    return table


_ITEMS = """
    p         text    landmark_names!
    n         text    item! sequence"""

_IN_VIDEO = """
    n         index   frame
    n         number  time"""

LANDMARKS = Layout(
    "shapefit-landmarks",
    "landmarks",
    _table(
        f"""{_ITEMS}
    n,p,2     points  landmarks!
    n,p       number  confidence"""
    ),
    _table(_IN_VIDEO),
)

SHAPES = Layout(
    "shapefit-shapes",
    "shapes",
    _table(
        f"""{_ITEMS}
    n,p,3     points  shapes!
    e,2       index   edges
    n,q,3     points  mesh_vertices
    f,3       index   mesh_faces"""
    ),
    _table(
        f"""{_IN_VIDEO}
    p         index   mirror_index"""
    ),
)

PROOF = _table(
    """
    n,p,2     points  dual
    n,2       number  convex_translation
    n         number  convex_objective convex_relative_gap
    n         index   transform_count
    a         index   transform_atom
    a,2,3     number  active_transforms"""
)
"""What proves the optimum of the convex program of a result, beside its landmarks and
lambda.
"""

RESULTS = Layout(
    "shapefit-result",
    "shapes",
    _table(
        f"""{_ITEMS}
    n,p,3     points  shapes! shape_sd
    n,p,2     points  landmarks_fitted
    n,k       number  coefficients
    n,3,3     number  rotation
    n,2       number  translation
    n         number  scale objective relative_gap
    n         index   iterations
    n         text    status
    n,k,2,3   number  transforms
    n,q,3     points  mesh_vertices"""
    )
    | PROOF,
    _table(
        f"""{_IN_VIDEO}
    n         number  lambda residual active_atoms tight metres_per_unit
    n         number  log_evidence p_value
    n         number  trusted sequence_noise start_distance expected_error image_error
    n         number  sides_exchanged
    n,2       number  focal principal_point
    n,3       number  camera_translation position
    n,p       number  inlier_probability outliers
    n,p,2     number  landmarks
    n,p,3     number  shape_correlation
    n,r,r     number  shape_covariance
    n,i,3     number  input_shapes input_shape_sd input_shape_correlation
    p,p       number  landmark_map
    n         text    reasons omitted
    i         text    input_landmark_names"""
    ),
)

DICTIONARY = Layout(
    "shapefit-dictionary",
    "atoms",
    _table(
        """
    p         text    landmark_names!
    k,p,3     points  atoms!
    p,3       points  mean_shape!
    e,2       index   edges
    p         index   mirror_index
    k,q,3     points  mesh_vertices
    f,3       index   mesh_faces
    k         number  atom_scale
    k         text    atom_item
    t         number  objective_trace
    p         number  acceleration
    e         number  bone_tolerance edge_length
    e,e       number  edge_covariance
    1         number  residual_variance
    w,4       number  p_value_table
    c         number  prior_weights
    c,p,3     points  prior_means
    c,p,3,p,3 number  prior_covariances"""
    ),
)

LAYOUTS = {layout.name: layout for layout in (LANDMARKS, SHAPES, RESULTS, DICTIONARY)}
"""The layouts by the attribute `format`."""


def fit_axes(axes: Axes, shape: tuple[int, ...], sizes: dict[str, int]) -> bool:
    """Whether a shape has these axes; sizes of letters that are new are added to
    `sizes`.
    """
    fitting = [
        (sizes.setdefault(axis, size) if isinstance(axis, str) else axis) == size
        for axis, size in zip(axes, shape, strict=False)
    ]
    return len(shape) == len(axes) and all(fitting)


def free_names(names: Iterable[str], taken: Collection[str]) -> dict[str, str]:
    """Return the name under which each dataset can stand in a file that has those in
    `taken`.

    `input_` is put before a name that is taken, or whose group is, until it is free.
    """
    names, free = list(names), {}
    for name in names:
        new = name
        while new.partition("/")[0] in taken or (new != name and new in names):
            new = f"input_{new}"
        free[name] = new
    return free
