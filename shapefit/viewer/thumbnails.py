"""Small drawings of single frames for a report: the image left, another view of the shape right."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.meshes.ellipses import Ellipses, covariances, seen_ellipses
from shapefit.meshes.views import View, YAxis, upright
from shapefit.viewer.scene import Layer, Scene

SIDE = 120
"""Width and height of a panel in pixels; there are two."""
FILL = 0.44
"""Share of a panel from its middle to the farthest point."""
NOVEL = View(45, 10)


def thumbnail(scene: Scene, frame: int, layer: Layer) -> str:
    """Return an SVG element that shows one frame of a result, with the truth where it is known.

    Left the observed landmarks over the fitted ones, right the shape over the truth, seen from
    another side. Holds numbers only, no names.
    """
    y_axis: YAxis = "down" if scene.y_down else "up"
    flat = in_image(layer, frame, layer.points[frame])
    flat = flat if layer.fitted is None else layer.fitted[frame]
    seen = np.full_like(flat, np.nan) if scene.seen is None else scene.seen[frame]
    truth = next((each.points[frame] for each in scene.layers if each.role == "truth"), None)
    body = mesh_vertices(scene, frame, layer)

    left = [("result", upright(flat, y_axis)), ("seen", upright(seen, y_axis))]
    if body is not None:
        left.append(("body", upright(in_image(layer, frame, body), y_axis)))
    turned = NOVEL.rotation()
    right = [("result", (turned @ upright(layer.points[frame], y_axis))[:2])]
    if truth is not None:
        right.append(("truth", (turned @ upright(truth, y_axis))[:2]))
    if body is not None:
        right.append(("body", (turned @ upright(body, y_axis))[:2]))

    outliers = None if scene.outliers is None else scene.outliers[frame]
    bars: list[Ellipses | None] = [None, None]
    if layer.sd is not None:
        C = covariances(layer.sd[frame])
        bars = [seen_ellipses(C, view, y_axis) for view in (np.eye(3), turned)]
    parts = [
        *_panel(dict(left), scene.edges, outliers, 0, bars[0]),
        *_panel(dict(right), scene.edges, None, SIDE, bars[1]),
    ]
    return (
        f'<svg viewBox="0 0 {2 * SIDE} {SIDE}" role="img" aria-label="The image, and another view">'
        f"{''.join(parts)}</svg>"
    )


def in_image(layer: Layer, frame: int, points: Floats) -> Floats:
    """Return where (2, q) the image shows points (3, q) of a layer: x and y, or in perspective."""
    if layer.camera is None or layer.pose is None:
        return points[:2]
    position, focal, centre = np.split(layer.camera[frame], [3, 5])
    scale, T = layer.pose[frame, 9], layer.pose[frame, 10:]
    X = (points - T[:, None]) / scale + position[:, None]
    seen: Floats = focal[:, None] * X[:2] / np.abs(X[2]) + centre[:, None]
    return seen


def mesh_vertices(scene: Scene, frame: int, layer: Layer) -> Floats | None:
    """Return the blended mesh (3, q) of a frame, as the page does; None where there is none."""
    if layer.blend is None or layer.pose is None:
        return None
    start, end = layer.blend.start[frame : frame + 2]
    if start == end:
        return None
    atoms = scene.meshes[layer.blend.mesh_set].vertices[layer.blend.atom[start:end]]
    mixed = np.tensordot(layer.blend.weight[start:end], atoms, axes=1)
    R, scale, t = layer.pose[frame, :9].reshape(3, 3), layer.pose[frame, 9], layer.pose[frame, 10:]
    placed: Floats = scale * (R @ mixed) + t[:, None]
    return placed


def _panel(
    points: dict[str, Floats],
    edges: NDArray[np.int64],
    outliers: NDArray[np.bool_] | None,
    left: int,
    bars: Ellipses | None,
) -> list[str]:
    every = np.concatenate(list(points.values()), axis=1)
    every = every[:, np.isfinite(every).all(axis=0)]
    if not every.size:
        return []
    low, high = every.min(axis=1), every.max(axis=1)
    zoom = 2 * FILL * SIDE / (float((high - low).max()) or 1.0)
    middle = (low + high) / 2
    placed = {
        name: np.array([[left + SIDE / 2], [SIDE / 2]])
        + np.array([[zoom], [-zoom]]) * (values - middle[:, None])
        for name, values in points.items()
    }
    drawn = [_hull(placed["body"])] if "body" in placed else []
    if bars is not None:
        drawn.append(_bars(placed["result"], bars, zoom))
    if "truth" in placed:
        drawn += _skeleton(placed["truth"], edges, "truth")
    drawn += _skeleton(placed["result"], edges, "result")
    if "seen" in placed:
        residuals = np.stack([placed["seen"].T, placed["result"].T], axis=1)
        drawn.append(_lines(residuals, "residual"))
        bad = np.zeros(placed["seen"].shape[1], bool) if outliers is None else outliers
        drawn.append(_dots(placed["seen"][:, ~bad], "seen"))
        drawn.append(_dots(placed["seen"][:, bad], "outlier"))
    return [part for part in drawn if part]


def _bars(points: Floats, bars: Ellipses, zoom: float) -> str:
    """Draw the ellipses around points (2, p) of the drawing; its y points down."""
    drawn = []
    for point, (a, b), angle in zip(points.T, zoom * bars.semi_axes, bars.angle, strict=True):
        if np.isfinite([*point, a, b]).all() and a > 0:
            along = a * np.array([np.cos(angle), -np.sin(angle)])
            arc = f"A{a:.1f} {b:.1f} {-np.degrees(angle):.0f} 0 1"
            start, end = _pair(point - along), _pair(point + along)
            drawn.append(f"M{start}{arc} {end}{arc} {start}")
    return f'<path class="bar" d="{"".join(drawn)}"/>' if drawn else ""


def _skeleton(points: Floats, edges: NDArray[np.int64], kind: str) -> list[str]:
    if not len(edges):
        return [_dots(points, f"{kind} dots")]
    return [_lines(points.T[edges], kind)]


def _lines(lines: Floats, kind: str) -> str:
    known = lines[np.isfinite(lines).all(axis=(1, 2))]
    path = "".join(f"M{_pair(start)}L{_pair(end)}" for start, end in known)
    return f'<path class="{kind}" d="{path}"/>' if path else ""


def _dots(points: Floats, kind: str) -> str:
    path = "".join(f"M{_pair(point)}h0" for point in points.T if np.isfinite(point).all())
    return f'<path class="{kind}" d="{path}"/>' if path else ""


def _hull(points: Floats) -> str:
    """Fill the convex hull of a mesh."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        corners = points.T[ConvexHull(points.T).vertices]
    except (QhullError, ValueError):
        return ""
    return f'<path class="body" d="M{"L".join(map(_pair, corners))}Z"/>'


def _pair(point: Floats) -> str:
    return f"{point[0]:.1f} {point[1]:.1f}"
