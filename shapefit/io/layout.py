"""The datasets of each kind of file: those of records follow from their fields, those
of dictionaries are listed here, once for reader and writer.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import NamedTuple

from shapefit.arrays import Floats, Integers
from shapefit.records.columns import COUNTS, Column, Texts, columns_of
from shapefit.records.fit import Fit
from shapefit.records.items import UNKNOWN_UNIT, Items
from shapefit.records.landmarks import Landmarks
from shapefit.records.shapes import Shapes

__all__ = ["COUNTS", "UNKNOWN_UNIT"]

VERSION = 2

PER_ITEM = "per_item"
"""Attribute of a dataset: whether it has a row for each item."""

CONTENTS = "contents_digest"
"""Root attribute of a result of `fit`: the digest of all else that the file holds."""

INPUT_ROWS = "input_rows"
"""Root attribute of a result of some rows of its input: first:end, from 0."""

RENAMED = {
    "belief": "inlier_probability",
    "doubt": "reasons",
    "edge_give": "bone_tolerance",
    "left_out": "omitted",
    "misfit": "residual_variance",
    "plausibility": "p_value",
}
"""Datasets of version 1 -> their names."""

OF_FILE = {
    **dict.fromkeys(("camera_matrix", "extrinsic_rotation", "edges"), 2),
    **dict.fromkeys(
        ("distortion", "removed_distortion", "image_size", "mirror_index"), 1
    ),
    "extrinsic_translation": 1,
}
"""Datasets that no layout lists and that belong to the file when they have so many
axes, where the file does not say it.
"""

EDGES = "edges"
FRAME = "frame"
TIME = "time"

CORRUPTED = "corrupted"
LABELS = ("outliers", CORRUPTED)
"""Datasets (n, p) of the landmarks that a fit calls outliers, and of those that were
made so.
"""

METRES_FROM = "metres_from"
"""Root attribute: by what metres_per_unit was found, edges or spread."""

FOCAL_ASSUMED = "assumed_focal"
"""Root attribute: the focal length that a fit assumed, where nobody stated one."""


class Layout(NamedTuple):
    """The datasets of one kind of file.

    name is the root attribute `format`, points the dataset that every file has; record
    is the class of what it holds, None for dictionaries. In files of version 2 the
    datasets `unmarked` are of items without the attribute PER_ITEM.
    """

    name: str
    points: str
    columns: Mapping[str, Column]
    record: type[Items] | None
    unmarked: frozenset[str]

    @property
    def kind(self) -> str:
        """The kind of file: landmarks, shapes, result or dictionary."""
        return self.name.removeprefix("shapefit-")

    def is_per_item(self, name: str, axes: int) -> bool:
        """Whether a dataset of this name and number of axes has a row for each item.

        That is for files that do not state it.
        """
        column = self.columns.get(name)
        return 0 < axes != OF_FILE.get(name) if column is None else column.per_item


def _layout_of(name: str, record: type[Items], unmarked: str) -> Layout:
    """Make the layout of files of a class of records, from the fields of the class.

    `unmarked` are names of datasets, with spaces between.
    """
    columns = {column.name: column for column in columns_of(record)}
    # Names of landmarks and items have a default in memory; every file has them.
    for field in ("landmark_names", "item"):
        columns[field] = columns[field]._replace(required=True)
    always = ("item", "sequence", record.POINTS)
    return Layout(
        name, record.POINTS, columns, record, frozenset({*always, *unmarked.split()})
    )


LANDMARKS = _layout_of("shapefit-landmarks", Landmarks, "confidence")

SHAPES = _layout_of("shapefit-shapes", Shapes, "mesh_vertices")

PROOF = frozenset(
    {
        "dual",
        "convex_translation",
        "convex_objective",
        "convex_relative_gap",
        "transform_count",
        "transform_atom",
        "active_transforms",
    }
)
"""What proves the optimum of the convex program of a result, beside its landmarks and
lambda.
"""

RESULTS = _layout_of(
    "shapefit-result",
    Fit,
    "shape_sd landmarks_fitted coefficients rotation translation scale objective"
    f" relative_gap iterations status transforms mesh_vertices {' '.join(PROOF)}",
)

DICTIONARY_COLUMNS = (
    Column("landmark_names", "landmark_names", ("p",), Texts, required=True),
    Column("atoms", "atoms", ("k", "p", 3), Floats, required=True),
    Column("mean_shape", "mean_shape", ("p", 3), Floats, required=True),
    Column("edges", "edges", ("e", 2), Integers),
    Column("mirror_index", "mirror_index", ("p",), Integers),
    Column("mesh_vertices", "mesh_vertices", ("k", "q", 3), Floats),
    Column("mesh_faces", "mesh_faces", ("f", 3), Integers),
    Column("atom_scale", "atom_scale", ("k",), Floats),
    Column("atom_origin", "atom_origin", ("k", 3), Floats),
    Column("atom_items", "atom_item", ("k",), Texts),
    Column("objective_trace", "objective_trace", ("t",), Floats),
    Column("acceleration", "acceleration", ("p",), Floats),
    Column("bone_tolerance", "bone_tolerance", ("e",), Floats),
    Column("edge_length", "edge_length", ("e",), Floats),
    Column("edge_covariance", "edge_covariance", ("e", "e"), Floats),
    Column("residual_variance", "residual_variance", (1,), Floats),
    Column("p_value_table", "p_value_table", ("w", 4), Floats),
    Column("prior_weights", "prior_weights", ("c",), Floats),
    Column("prior_means", "prior_means", ("c", "p", 3), Floats),
    Column("prior_covariances", "prior_covariances", ("c", "p", 3, "p", 3), Floats),
)

DICTIONARY_POINTS = ("atoms", "mean_shape", "mesh_vertices", "prior_means")
"""Points of a dictionary: one a row in files and in Python, one a column in the
mathematics.
"""

DICTIONARY = Layout(
    "shapefit-dictionary",
    "atoms",
    {column.name: column for column in DICTIONARY_COLUMNS},
    None,
    frozenset(),
)

LAYOUTS = {layout.name: layout for layout in (LANDMARKS, SHAPES, RESULTS, DICTIONARY)}
"""The layouts by the attribute `format`."""

LAYOUT_OF = {Landmarks: LANDMARKS, Shapes: SHAPES, Fit: RESULTS}
"""The layouts by the class of their records."""


def free_names(names: Iterable[str], taken: Collection[str]) -> dict[str, str]:
    """Return name -> name of each dataset, renamed where it is one of those `taken`.

    `input_` is put before a name that is taken, or whose group is, until it is free.
    """
    names = list(names)
    free = {}
    for name in names:
        new = name
        while new.partition("/")[0] in taken or (new != name and new in names):
            new = f"input_{new}"
        free[name] = new
    return free
