"""The datasets of each file format: names, axes and kinds, stated once for reader and writer."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Set
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

Kind = Literal["number", "index", "text", "label"]


@dataclass(frozen=True)
class Dataset:
    """One dataset of a format.

    `axes` are as in the file: letters for sizes that agree over the file (n items, p landmarks,
    q mesh vertices, k atoms, ...), numbers for fixed sizes. `points` marks coordinates, one point
    per row in the file (..., p, 3) and per column in memory (..., 3, p). `field` names the field
    of the record. A "label" is text or an integer code. `counted_by` names the dataset that says
    how many rows of this one belong to each item, one item after the other. `stored` is the NumPy
    type in the file where it is smaller than that in memory; `sparse` numbers are mostly 0 and are
    compressed there.
    """

    name: str
    axes: tuple[str | int, ...]
    kind: Kind = "number"
    required: bool = False
    points: bool = False
    field: str = ""
    counted_by: str = ""
    sparse: bool = False
    stored: str = ""

    @property
    def attribute(self) -> str:
        """Name of the field of the record that holds it."""
        return self.field or self.name

    @property
    def per_item(self) -> bool:
        """Whether its first axis runs over the items."""
        return self.axes[0] == "n"

    @property
    def grows(self) -> bool:
        """Whether it gets longer with more items."""
        return self.per_item or bool(self.counted_by)

    @property
    def memory_axes(self) -> tuple[str | int, ...]:
        """Axes of the array in memory."""
        if not self.points:
            return self.axes
        return (*self.axes[:-2], self.axes[-1], self.axes[-2])


def fit_axes(axes: tuple[str | int, ...], shape: tuple[int, ...], sizes: dict[str, int]) -> bool:
    """Whether a shape has these axes; the sizes of those that were not known are added."""
    fitting = [
        (sizes.setdefault(axis, size) if isinstance(axis, str) else axis) == size
        for axis, size in zip(axes, shape, strict=False)
    ]
    return len(shape) == len(axes) and all(fitting)


@dataclass(frozen=True)
class Layout:
    """The datasets of one kind of file; `name` is the value of its root attribute `format`.

    `further` may stand beside them; in memory they are as in the file.
    """

    name: str
    datasets: tuple[Dataset, ...]
    further: tuple[Dataset, ...] = ()

    @property
    def kind(self) -> str:
        """What a file of it holds: landmarks, shapes, result or dictionary."""
        return self.name.removeprefix("shapefit-")

    @property
    def points(self) -> Dataset:
        """The dataset that every item has: its landmarks, or its shape."""
        return next(known for known in self.datasets if known.required and known.points)

    @cached_property
    def by_name(self) -> dict[str, Dataset]:
        """The datasets by their names."""
        return {dataset.name: dataset for dataset in self.datasets}

    @property
    def names(self) -> Set[str]:
        """Names of the datasets."""
        return self.by_name.keys()

    @cached_property
    def all_names(self) -> frozenset[str]:
        """Names of the datasets, and of those that may stand beside them."""
        return frozenset(self.names | {dataset.name for dataset in self.further})


VERSION = 1
UNKNOWN_UNIT = "unknown"

# Root attributes that the formats define; others of the same name are stored with a prefix.
PLAIN_ATTRIBUTES = frozenset({"format", "version", "unit", "y_axis", "frame_rate"})
_PREFIX = "shapefit_"

# Attribute of a carried dataset: False where it belongs to the file, whatever its shape suggests.
PER_ITEM_FLAG = "per_item"

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
    "l": "cells of trees",
    "v": "vertices of trees",
    "i": "landmarks of the detector",
    "r": "coordinates of all landmarks",
}

_LANDMARK_NAMES = Dataset("landmark_names", ("p",), "text", required=True)
_ITEM = Dataset("item", ("n",), "text", required=True, field="items")
_SEQUENCE = Dataset("sequence", ("n",), "text", field="sequences")
_EDGES = Dataset("edges", ("e", 2), "index")
_MESH_FACES = Dataset("mesh_faces", ("f", 3), "index")
_MESH_VERTICES = Dataset("mesh_vertices", ("n", "q", 3), points=True)

SHAPES = Layout(
    "shapefit-shapes",
    (
        _LANDMARK_NAMES,
        _ITEM,
        Dataset("shapes", ("n", "p", 3), required=True, points=True),
        _SEQUENCE,
        _EDGES,
        _MESH_VERTICES,
        _MESH_FACES,
    ),
)

LANDMARKS = Layout(
    "shapefit-landmarks",
    (
        _LANDMARK_NAMES,
        _ITEM,
        Dataset("landmarks", ("n", "p", 2), required=True, points=True),
        Dataset("confidence", ("n", "p")),
        _SEQUENCE,
    ),
)

TRANSFORM_COUNT = Dataset("transform_count", ("n",), "index", stored="int32")

PROOF = (
    Dataset("dual", ("n", "p", 2), points=True),
    Dataset("convex_translation", ("n", 2)),
    Dataset("convex_objective", ("n",)),
    Dataset("convex_relative_gap", ("n",)),
    TRANSFORM_COUNT,
    Dataset("transform_atom", ("a",), "index", counted_by=TRANSFORM_COUNT.name, stored="int32"),
    Dataset("active_transforms", ("a", 2, 3), counted_by=TRANSFORM_COUNT.name),
)
"""What proves the optimum of the convex program of a result, beside its landmarks and lambda."""

TREE_CELLS = Dataset("tree_cells", ("n",), "index", stored="int32")
TREE_VERTICES = Dataset("tree_vertices", ("n",), "index", stored="int32")

TREES = (
    TREE_CELLS,
    Dataset("tree_splits", ("l",), "index", counted_by=TREE_CELLS.name, stored="int8"),
    TREE_VERTICES,
    Dataset("tree_rotations", ("v", 4), counted_by=TREE_VERTICES.name),
    Dataset("tree_multipliers", ("v", "p", 2), points=True, counted_by=TREE_VERTICES.name),
)
"""What proves the bound on all rotations of some images."""

INPUT_SHAPES, INPUT_SD = "input_shapes", "input_shape_sd"
INPUT_CORRELATION, INPUT_NAMES = "input_shape_correlation", "input_landmark_names"
"""Of a result: the landmarks of the files in 3D with their error bars, beside the joints."""

_NUMBERS_OF_A_RESULT: dict[tuple[str | int, ...], str] = {
    ("n",): "lambda residual active_atoms tight metres_per_unit log_evidence "
    "p_value trusted sequence_noise",
    ("n", 2): "focal principal_point",
    ("n", 3): "camera_translation position",
    ("n", "p"): "inlier_probability outliers",
    ("n", "p", 2): "landmarks",
    ("n", "p", 3): "shape_correlation",
    ("n", "r", "r"): "shape_covariance",
    ("n", "i", 3): f"{INPUT_SHAPES} {INPUT_SD} {INPUT_CORRELATION}",
    ("p", "p"): "landmark_map",
}

FURTHER_OF_RESULTS = (
    *(
        Dataset(name, axes)
        for axes, names in _NUMBERS_OF_A_RESULT.items()
        for name in names.split()
    ),
    Dataset("reasons", ("n",), "text"),
    Dataset("left_out", ("n",), "text"),
    Dataset(INPUT_NAMES, ("i",), "text"),
)
"""What a fit can write beside; in memory as in the file."""

RESULTS = Layout(
    "shapefit-result",
    (
        _LANDMARK_NAMES,
        _ITEM,
        Dataset("shapes", ("n", "p", 3), required=True, points=True),
        Dataset("landmarks_fitted", ("n", "p", 2), points=True),
        Dataset("coefficients", ("n", "k"), sparse=True),
        Dataset("rotation", ("n", 3, 3)),
        Dataset("translation", ("n", 2)),
        Dataset("scale", ("n",)),
        Dataset("objective", ("n",)),
        Dataset("relative_gap", ("n",)),
        Dataset("iterations", ("n",), "index"),
        Dataset("status", ("n",), "label"),
        _SEQUENCE,
        Dataset("shape_sd", ("n", "p", 3), points=True),
        Dataset("transforms", ("n", "k", 2, 3)),
        _MESH_VERTICES,
        *PROOF,
        *TREES,
    ),
    FURTHER_OF_RESULTS,
)

DICTIONARY = Layout(
    "shapefit-dictionary",
    (
        _LANDMARK_NAMES,
        Dataset("atoms", ("k", "p", 3), required=True, points=True),
        Dataset("mean_shape", ("p", 3), required=True, points=True),
        _EDGES,
        Dataset("mirror_index", ("p",), "index"),
        Dataset("mesh_vertices", ("k", "q", 3), points=True),
        _MESH_FACES,
        Dataset("atom_scale", ("k",)),
        Dataset("atom_item", ("k",), "text", field="atom_items"),
        Dataset("objective_trace", ("t",)),
        Dataset("acceleration", ("p",)),
        Dataset("bone_tolerance", ("e",)),
        Dataset("edge_length", ("e",)),
        Dataset("edge_covariance", ("e", "e")),
        Dataset("residual_variance", (1,)),
        Dataset("prior_weights", ("c",)),
        Dataset("prior_means", ("c", "p", 3), points=True),
        Dataset("prior_covariances", ("c", "p", 3, "p", 3)),
    ),
)

LAYOUTS = {layout.name: layout for layout in (LANDMARKS, SHAPES, RESULTS, DICTIONARY)}
"""The layouts by what a file says of itself."""


OF_THE_FILE = {
    "camera_matrix": 2,
    "distortion": 1,
    "edges": 2,
    "extrinsic_rotation": 2,
    "extrinsic_translation": 1,
    "image_size": 1,
    "input_landmark_names": 1,
    "landmark_map": 2,
    "mirror_index": 1,
    "removed_distortion": 1,
}
"""Datasets that belong to the file when they have so many axes, however many items there are."""

EDGES = "edges"
"""Dataset (e, 2) of landmarks and of results: pairs of landmarks that a line joins."""

OUTLIERS, CORRUPTED = "outliers", "corrupted"
"""Datasets (n, p) of the landmarks that a fit judged wrong, and of those that were made wrong."""
LABELS = (OUTLIERS, CORRUPTED)

LANDMARK_COVARIANCE = "landmark_covariance"
"""Covariance (n, p, 2, 2) of each landmark, in the unit of the landmarks squared."""

METRES_PER_UNIT = "metres_per_unit"
"""Dataset (n,) of results: metres in one unit of the shape of each image."""

METRES_FROM = "metres_from"
"""Attribute of results that have it: by what the size was found, edges or spread."""


def is_per_item(name: str, shape: tuple[int, ...], count: int) -> bool:
    """Whether a dataset of this shape has a row for each of `count` items."""
    return shape[:1] == (count,) and OF_THE_FILE.get(name) != len(shape)


def free_names(names: Iterable[str], taken: Collection[str]) -> dict[str, str]:
    """Return the name under which each dataset can stand in a file that has those in `taken`.

    `input_` is put before a name that is taken until it is free. In HDF5 the dataset `a/b` lies in
    the group `a`, for which there is no room where `a` is a dataset.
    """
    names = list(names)
    groups = {_group(name) for name in names}

    def apart(name: str) -> str:
        free = name
        while _group(free) in taken or (free != name and _group(free) in groups):
            free = f"input_{free}"
        return free

    return {name: apart(name) for name in names}


def _group(name: str) -> str:
    return name.partition("/")[0]


def stored_name(attribute: str) -> str:
    """Name of the root attribute that holds a record's attribute."""
    return _PREFIX + attribute if attribute in PLAIN_ATTRIBUTES else attribute


def plain_name(stored: str) -> str:
    """Name of the record's attribute that a root attribute holds: undoes `stored_name`."""
    name = stored.removeprefix(_PREFIX)
    return name if name in PLAIN_ATTRIBUTES else stored
