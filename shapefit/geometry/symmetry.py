"""Left and right: mirror images of shapes, and the axis along which the sides lie apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats

Indices = NDArray[np.integer] | Sequence[int]


def mirror(shapes: Floats, mirror_index: Indices, lateral: int = 0) -> Floats:
    """F S P: negate the lateral coordinate and exchange each point with its partner.

    shapes (..., 3, p) in a frame whose plane of symmetry is `lateral` = 0 (x, y, z = 0, 1, 2);
    mirror_index (p,): the partner of each point, itself for a point on the plane. A shape that is
    symmetric comes back as it is. Mirroring turns the faces of a mesh inside out unless they map
    onto faces. Raises ValueError where mirror_index is not its own inverse.
    """
    partners = _partners(mirror_index, shapes.shape[-1])
    mirrored: Floats = shapes[..., partners]
    mirrored[..., lateral, :] *= -1
    return mirrored


def lateral_axis(shapes: Floats, mirror_index: Indices) -> int:
    """argmax_a sum over points of (x_a - x_a of the partner)^2: where left and right lie apart.

    shapes (..., 3, p) in frames that share their lateral axis -> 0, 1 or 2, as `lateral` of the
    other functions. Raises ValueError as `mirror` does.
    """
    apart = shapes - shapes[..., _partners(mirror_index, shapes.shape[-1])]
    return int((apart**2).sum(axis=-1).reshape(-1, 3).sum(axis=0).argmax())


def double(shapes: Floats, mirror_index: Indices, lateral: int = 0) -> Floats:
    """(n, 3, p) -> (2 n, 3, p): the shapes, then their mirror images in the same order.

    Arguments and errors as for `mirror`.
    """
    return np.concatenate([shapes, mirror(shapes, mirror_index, lateral)])


def _partners(mirror_index: Indices, points: int) -> NDArray[np.intp]:
    partners = np.asarray(mirror_index)
    if partners.shape != (points,):
        raise ValueError(f"mirror_index has shape {partners.shape}, not ({points},)")
    inside = ((partners >= 0) & (partners < points)).all()
    if not inside or (partners[partners] != np.arange(points)).any():
        raise ValueError("mirror_index does not pair the points: it is not its own inverse")
    return partners.astype(np.intp)
