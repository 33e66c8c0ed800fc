"""The recipe of docs/cars.md that makes shapes of meshes."""

import re
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest
from numpy.testing import assert_allclose

import shapefit

PAGE = Path(__file__).resolve().parents[2] / "docs" / "cars.md"

FACES = ((0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 2, 3), (3, 4, 5), (1, 4, 5))
"""Of the first six of seven vertices, in another order than these stand in the file."""


def obj(vertices: np.ndarray, corner: str) -> str:
    """Return an OBJ whose corners of faces are `v`, `v/t`, `v//n` or `v/t/n`."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += ["vt 0 0", "vt 1 0", "vt 1 1", "vn 0 0 1", "vn 0 1 0", "vn 1 0 0"]
    for number, face in enumerate(FACES[::-1]):
        corners = (
            corner.format(v=v + 1, t=1 + (v + number) % 3, n=1 + number % 3)
            for v in face
        )
        lines.append(f"f {' '.join(corners)}")
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("corner", ["{v}", "{v}/{t}", "{v}//{n}", "{v}/{t}/{n}"])
def test_landmarks_are_the_vertices_of_the_file(tmp_path, monkeypatch, rng, corner):
    (recipe,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    numbers = '{"left_mirror": 17, "right_mirror": 240}'
    assert numbers in recipe
    recipe = dedent(recipe).replace(numbers, str({f"c{n}": n for n in range(7)}))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "models").mkdir()
    vertices = np.round(rng.normal(size=(3, 7, 3)), 6)
    for number, own in enumerate(vertices):
        (tmp_path / f"models/m{number}.obj").write_text(obj(own, corner))
    exec(recipe, {})
    shapes = shapefit.read_shapes("models.h5")
    assert shapes.items == ("m0", "m1", "m2")
    assert_allclose(shapes.shapes, vertices, atol=1e-6)
