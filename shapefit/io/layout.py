"""The datasets of each file format: names, axes and kinds, stated once for reader and writer."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Set
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, NamedTuple

Axes = tuple[str | int, ...]


class Column(NamedTuple):
    """One dataset of a format.

    `axes` are as in the file: letters for sizes that agree over the file (see AXES), numbers for
    fixed sizes. `points` marks coordinates, one point per row in the file (..., p, 3) and per
    column in memory (..., 3, p). A "label" is text or an integer code. `counted_by` names the
    dataset that says how many rows of this one belong to each item, one item after the other.
    `stored` is the NumPy type in the file where it is smaller than that in memory.
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

    @property
    def memory_axes(self) -> Axes:
        """Axes of the array in memory."""
        return (*self.axes[:-2], self.axes[-1], self.axes[-2]) if self.points else self.axes


Table = dict[str, Column]


@dataclass(frozen=True, eq=False)
class Layout:
    """The datasets of one kind of file; `name` is the value of its root attribute `format`.

    `points` is the dataset that every file has: landmarks, shapes or atoms. `further` datasets may
    stand beside those of the layout; in memory they are as in the file. `old_versions` hold the
    same as today's, and every command reads them; others are read by `convert` and `info` alone.
    """

    name: str
    points: str
    datasets: Table
    further: Table = field(default_factory=dict)
    old_versions: tuple[int, ...] = ()

    @property
    def kind(self) -> str:
        """What a file of it holds: landmarks, shapes, result or dictionary."""
        return self.name.removeprefix("shapefit-")

    @property
    def names(self) -> Set[str]:
        """Names of the datasets, without those that may stand beside them."""
        return self.datasets.keys()

    @cached_property
    def all(self) -> Table:
        """All datasets, with those that may stand beside."""
        return self.datasets | self.further

    def is_per_item(self, name: str, axes: int) -> bool:
        """Whether a dataset of so many axes has rows for each item, unless something says more.

        Only datasets that are known to belong to the file do not.
        """
        known = self.all.get(name)
        return 0 < axes != WHOLE.get(name) if known is None else known.per_item


VERSION = 2
UNKNOWN_UNIT = "unknown"

# Root attributes that the formats define; others of the same name are stored with a prefix.
PLAIN_ATTRIBUTES = frozenset({"format", "version", "unit", "y_axis", "frame_rate"})
_PREFIX = "shapefit_"

DIGEST = "attributes_sha256"
"""Root attribute: SHA-256 of those that are texts."""

PER_ITEM = "per_item"
"""Attribute of a dataset that no layout lists: whether it has a row for each item."""

RENAMED = {
    "belief": "inlier_probability",
    "doubt": "reasons",
    "edge_give": "bone_tolerance",
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
    "w": "scales and numbers of landmarks",
    "a": "active transforms",
    "i": "landmarks of the detector",
    "r": "coordinates of all landmarks",
}


def _numbers(axes: Axes, names: str) -> Table:
    return {name: Column(axes) for name in names.split()}


_NAMES = {"landmark_names": Column(("p",), "text", required=True)}
_ITEMS = {
    **_NAMES,
    "item": Column(("n",), "text", required=True),
    "sequence": Column(("n",), "text"),
}
_EDGES = {"edges": Column(("e", 2), "index")}
_FACES = {"mesh_faces": Column(("f", 3), "index")}
_VERTICES = {"mesh_vertices": Column(("n", "q", 3), points=True)}
_SHAPES = {"shapes": Column(("n", "p", 3), required=True, points=True)}

LANDMARKS = Layout(
    "shapefit-landmarks",
    "landmarks",
    {
        **_ITEMS,
        "landmarks": Column(("n", "p", 2), required=True, points=True),
        "confidence": Column(("n", "p")),
    },
    old_versions=(1,),
)

SHAPES = Layout(
    "shapefit-shapes",
    "shapes",
    {**_ITEMS, **_SHAPES, **_EDGES, **_VERTICES, **_FACES},
    old_versions=(1,),
)

PROOF = {
    "dual": Column(("n", "p", 2), points=True),
    "convex_translation": Column(("n", 2)),
    "convex_objective": Column(("n",)),
    "convex_relative_gap": Column(("n",)),
    "transform_count": Column(("n",), "index", stored="int32"),
    "transform_atom": Column(("a",), "index", counted_by="transform_count", stored="int32"),
    "active_transforms": Column(("a", 2, 3), counted_by="transform_count"),
}
"""What proves the optimum of the convex program of a result, beside its landmarks and lambda."""

INPUT_SHAPES, INPUT_SD = "input_shapes", "input_shape_sd"
INPUT_CORRELATION, INPUT_NAMES = "input_shape_correlation", "input_landmark_names"
"""Of a result: the landmarks of the files in 3D with their error bars, beside the joints."""

RESULTS = Layout(
    "shapefit-result",
    "shapes",
    {
        **_ITEMS,
        **_SHAPES,
        "landmarks_fitted": Column(("n", "p", 2), points=True),
        "coefficients": Column(("n", "k")),
        "rotation": Column(("n", 3, 3)),
        "translation": Column(("n", 2)),
        **_numbers(("n",), "scale objective relative_gap"),
        "iterations": Column(("n",), "index"),
        "status": Column(("n",), "label"),
        "shape_sd": Column(("n", "p", 3), points=True),
        "transforms": Column(("n", "k", 2, 3)),
        **_VERTICES,
        **PROOF,
    },
    {
        **_numbers(
            ("n",),
            "lambda residual active_atoms tight metres_per_unit log_evidence p_value trusted "
            "sequence_noise start_distance expected_error sides_exchanged",
        ),
        **_numbers(("n", 2), "focal principal_point"),
        **_numbers(("n", 3), "camera_translation position"),
        **_numbers(("n", "p"), "inlier_probability outliers"),
        **_numbers(("n", "p", 2), "landmarks"),
        **_numbers(("n", "p", 3), "shape_correlation"),
        **_numbers(("n", "r", "r"), "shape_covariance"),
        **_numbers(("n", "i", 3), f"{INPUT_SHAPES} {INPUT_SD} {INPUT_CORRELATION}"),
        **_numbers(("p", "p"), "landmark_map"),
        "reasons": Column(("n",), "text"),
        "left_out": Column(("n",), "text"),
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
        "mesh_vertices": Column(("k", "q", 3), points=True),
        **_FACES,
        "atom_scale": Column(("k",)),
        "atom_item": Column(("k",), "text"),
        "objective_trace": Column(("t",)),
        "acceleration": Column(("p",)),
        **_numbers(("e",), "bone_tolerance edge_length"),
        "edge_covariance": Column(("e", "e")),
        "residual_variance": Column((1,)),
        "p_value_table": Column(("w", 4)),
        "prior_weights": Column(("c",)),
        "prior_means": Column(("c", "p", 3), points=True),
        "prior_covariances": Column(("c", "p", 3, "p", 3)),
    },
)

LAYOUTS = {layout.name: layout for layout in (LANDMARKS, SHAPES, RESULTS, DICTIONARY)}
"""The layouts by what a file says of itself."""

WHOLE = {
    "camera_matrix": 2,
    "distortion": 1,
    "edges": 2,
    "extrinsic_rotation": 2,
    "extrinsic_translation": 1,
    "image_size": 1,
    "mirror_index": 1,
    "removed_distortion": 1,
}
"""Datasets that belong to the file when they have so many axes."""

EDGES = "edges"
"""Dataset (e, 2) of landmarks and of results: pairs of landmarks that a line joins."""

FRAME = "frame"
"""Dataset (n,): the place of each item in its video, from 0."""

OUTLIERS, CORRUPTED = "outliers", "corrupted"
"""Datasets (n, p) of the landmarks that a fit judged wrong, and of those that were made wrong."""
LABELS = (OUTLIERS, CORRUPTED)

LANDMARK_COVARIANCE = "landmark_covariance"
"""Covariance (n, p, 2, 2) of each landmark, in the unit of the landmarks squared."""

METRES_PER_UNIT = "metres_per_unit"
"""Dataset (n,) of results: metres in one unit of the shape of each image."""

METRES_FROM = "metres_from"
"""Attribute of results that have it: by what the size was found, edges or spread."""


def fit_axes(axes: Axes, shape: tuple[int, ...], sizes: dict[str, int]) -> bool:
    """Whether a shape has these axes; the sizes of those that were not known are added."""
    fitting = [
        (sizes.setdefault(axis, size) if isinstance(axis, str) else axis) == size
        for axis, size in zip(axes, shape, strict=False)
    ]
    return len(shape) == len(axes) and all(fitting)


def free_names(names: Iterable[str], taken: Collection[str]) -> dict[str, str]:
    """Return the name under which each dataset can stand in a file that has those in `taken`.

    `input_` is put before a name that is taken until it is free. In HDF5 the dataset `a/b` lies in
    the group `a`, for which there is no room where `a` is a dataset.
    """
    names = list(names)
    groups = {_group(name) for name in names}

    def first_free(name: str) -> str:
        free = name
        while _group(free) in taken or (free != name and _group(free) in groups):
            free = f"input_{free}"
        return free

    return {name: first_free(name) for name in names}


def _group(name: str) -> str:
    return name.partition("/")[0]


def stored_name(attribute: str) -> str:
    """Name of the root attribute that holds a record's attribute."""
    return _PREFIX + attribute if attribute in PLAIN_ATTRIBUTES else attribute


def plain_name(stored: str) -> str:
    """Name of the record's attribute that a root attribute holds: undoes `stored_name`."""
    name = stored.removeprefix(_PREFIX)
    return name if name in PLAIN_ATTRIBUTES else stored
