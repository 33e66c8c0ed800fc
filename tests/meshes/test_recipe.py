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
    lines += ["vt 0 0", "vt 1 0", "vt 1 1"]
    lines += ["vn 0 0 1", "vn 0 1 0", "vn 1 0 0"]
    for number, face in enumerate(FACES[::-1]):
        normal = 1 + number % 3
        corners = [
            corner.format(v=vertex + 1, t=1 + (vertex + number) % 3, n=normal)
            for vertex in face
        ]
        lines.append(f"f {' '.join(corners)}")
    return "\n".join(lines) + "\n"


@pytest.fixture
def recipe():
    """The code of the page, with a landmark for each vertex."""
    page = PAGE.read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    numbers = '{"left_mirror": 17, "right_mirror": 240}'
    assert numbers in code
    every_vertex = str({f"c{n}": n for n in range(7)})
    return dedent(code).replace(numbers, every_vertex)


@pytest.mark.parametrize("corner", ["{v}", "{v}/{t}", "{v}//{n}", "{v}/{t}/{n}"])
def test_landmarks_are_the_vertices_of_the_file(
    recipe, tmp_path, monkeypatch, rng, corner
):
    vertices = np.round(rng.normal(size=(3, 7, 3)), 6)
    models = tmp_path / "models"
    models.mkdir()
    for number, model_vertices in enumerate(vertices):
        path = models / f"m{number}.obj"
        path.write_text(obj(model_vertices, corner), encoding="utf-8")
    monkeypatch.chdir(tmp_path)

    exec(recipe, {})

    shapes = shapefit.read_shapes("models.h5")
    assert shapes.items == ("m0", "m1", "m2")
    assert_allclose(shapes.shapes, vertices, atol=1e-6)
