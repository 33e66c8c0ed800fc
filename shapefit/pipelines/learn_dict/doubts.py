"""What is doubtful of training shapes: sizes, sides of a body, landmarks in one place.

And shapes that are flat, as 2D landmarks with z = 0 are, which are refused.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Flags, Floats, evenly
from shapefit.errors import abbreviate, counted, input_error
from shapefit.geometry.normalisation import metres_in, normalise, std
from shapefit.records import Shapes

MAX_COMPARED_SHAPES = 96
"""Shapes that are compared with each other, spread over all."""

MIN_COMPARED_SHAPES = 4
"""Shapes of which there is a majority."""

MIRRORED_BELOW = 0.9
"""Share of the distance of two shapes, below which one fits better if it is mirrored.
"""

MIN_DECIDED_SHARE = 0.6
"""Of pairs, that must fit one way better."""

MIN_AGREED_SHARE = 0.95
"""Of these, that must agree on sides: people, who bend both ways, are mirror images of
each other here and there.
"""

OTHER_SIDE_SHARE = 0.3
"""Of pairs, by which a shape is of the other side."""

MAX_SIZE_RATIO = 10.0
"""Of the largest shape to the smallest: metres and millimetres differ by 1000."""


def check_not_flat(shapes: Shapes, place: str) -> None:
    """Raise InputError at `place` where z is constant: 2D landmarks, not shapes."""
    z = shapes.shapes[..., 2]
    if not z.size or np.ptp(z) > 0:
        return
    fault = f"z is {z.flat[0]:g} everywhere, so these are 2D landmarks, not 3D shapes"
    fix = "give shapes with depth, or, to learn from images, x and y without z"
    raise input_error(place, fault, fix)


def warn_of_shapes(shapes: Shapes) -> tuple[str, ...]:
    """Return warnings about sizes, mirrored shapes, and landmarks that coincide."""
    points = shapes.as_columns()
    warnings = [*warn_of_sizes(shapes)]
    mirrored = shapes.take(np.flatnonzero(find_mirrored(points))).items
    if mirrored:
        warnings.append(
            f"{len(mirrored)} of {counted(len(shapes), 'shape')} fit the others better"
            f" when they are mirrored ({abbreviate(mirrored)}): are left and right"
            " sides mixed? Mirror one kind, or learn each alone"
        )
    pairs = find_coinciding(points)
    if pairs:
        names = shapes.landmark_names
        listed = [f"{names[a]} and {names[b]}" for a, b in pairs]
        fault = f"landmarks that are one point in all shapes: {abbreviate(listed)}"
        warnings.append(f"{fault}; are the numbers of their vertices right?")
    return tuple(warnings)


def warn_of_sizes(shapes: Shapes) -> Iterator[str]:
    """Yield a warning where shapes in a unit of length differ much in size."""
    if not len(shapes) or metres_in(shapes.unit) is None:
        return
    sizes = std(shapes.as_columns())
    smallest = int(sizes.argmin())
    largest = int(sizes.argmax())
    if sizes[largest] <= MAX_SIZE_RATIO * sizes[smallest]:
        return
    times = f"{sizes[largest] / sizes[smallest]:,.0f}"
    yield (
        f"'{shapes.items[largest]}' is {times} times as large as"
        f" '{shapes.items[smallest]}', and both state {shapes.unit}: has one of them"
        " another unit? Sizes in metres follow from the mean"
    )


def find_mirrored(shapes: Floats) -> Flags:
    """Return which shapes (n, 3, p) are mirror images of the majority of them.

    Of a pair the distance after the best rotation is known from the singular values s
    of X Y^T: |X|^2 + |Y|^2 - 2 (s1 + s2 + sign s3), with the other sign for the mirror
    image. Shapes that fit both ways, as flat ones do, belong to neither side.
    """
    none = np.zeros(len(shapes), np.bool_)
    if len(shapes) < MIN_COMPARED_SHAPES:
        return none
    points = normalise(shapes).points
    few = points[evenly(len(points), MAX_COMPARED_SHAPES)]
    pairs = _compare_sides(few, few)
    # the side of each that agrees with most pairs
    sides = np.sign(np.linalg.eigh(pairs)[1][:, -1])
    sides *= np.sign(sides.sum()) or 1.0  # + is what most are
    decided = np.abs(pairs).mean()
    agreed = sides @ pairs @ sides / pairs.size
    if decided < MIN_DECIDED_SHARE or agreed < MIN_AGREED_SHARE * decided:
        return none
    votes = _compare_sides(points, few) @ sides / len(few)
    is_mirrored: Flags = np.asarray(votes < -OTHER_SIDE_SHARE)
    if is_mirrored.sum() <= len(shapes) / 2:
        return is_mirrored
    return np.asarray(votes > OTHER_SIDE_SHARE)


def _compare_sides(one: Floats, other: Floats) -> Floats:
    """Return 1 for pairs (n, m) of shapes of one side, -1 for mirror images, else 0."""
    cross = np.einsum("nip,mjp->nmij", one, other)
    s = np.linalg.svd(cross, compute_uv=False)
    sign = np.sign(np.linalg.det(cross))
    size = (one**2).sum((1, 2))[:, None] + (other**2).sum((1, 2))
    both = s[..., 0] + s[..., 1]
    third = sign * s[..., 2]
    as_is = np.sqrt(np.maximum(size - 2 * (both + third), 0))
    mirrored = np.sqrt(np.maximum(size - 2 * (both - third), 0))
    sides = np.zeros(as_is.shape)
    sides[as_is < MIRRORED_BELOW * mirrored] = 1.0
    sides[mirrored < MIRRORED_BELOW * as_is] = -1.0
    return sides


def find_coinciding(shapes: Floats) -> list[tuple[int, int]]:
    """Return pairs of landmarks that are in one place in all shapes (n, 3, p)."""
    first = shapes[0] if len(shapes) else np.empty((3, 0))
    order: NDArray[np.intp] = np.lexsort(first)
    pairs = []
    for a, b in zip(order[:-1].tolist(), order[1:].tolist(), strict=True):
        if (shapes[:, :, a] == shapes[:, :, b]).all():
            pairs.append((min(a, b), max(a, b)))
    return sorted(pairs)
