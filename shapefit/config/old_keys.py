"""Keys and values of earlier versions: what became of each, for the error that they cause."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

OLD_KEYS: Mapping[str, Mapping[str, str]] = {
    "LearnDictConfig": {
        "atom_bound": "leave it out: atoms have norm 1 at most, since the mean norm gave larger "
        "errors",
        "tolerance": "use `iterations`: a dictionary is learned in a fixed number of rounds",
        "energy": "use `bases`: a number below 1 is the share of the variation to hold",
        "components": "use `bases`: a whole number is the number of bases of each sequence",
    },
    "FitConfig": {
        "beta": "use `outliers.threshold`, the residual beyond which a landmark is wrong, of every "
        "method for outliers",
        "path": "use `shapefit sweep` with `vary: {fit.lambda: [...]}`, which measures errors too",
        "solver.name": "leave it out: there is one solver; the paper's ADMM is a reference",
        "solver.stop": "leave it out: the tolerance bounds the relative duality gap",
        "orthogonal": "use `rotations: orthogonal`",
        "export.rotation": "use `rotations`: shared for `shared`, and per-atom for `per-atom`",
        "alternation.multi_start": "use `alternation.views: all`",
        "alternation.tolerance": "leave it out: a relative fall of the objective below 1e-6 ends "
        "the rounds",
        "alternation.max_rounds": "leave it out: 500 rounds are the most for an image",
        "outliers.max_rounds": "leave it out: 100 rounds are the most for an image",
        "camera.max_rounds": "leave it out: 1000 rounds are the most for an image",
        "temporal": "use `method: sequences`, which took its place; it needs "
        "a dictionary with a prior (configs/people)",
    },
    "EvalConfig": {
        "published": "leave it out: `python -m benchmarks.published` sets the paper's rows beside "
        "a report",
        "caveats": "leave it out: `python -m benchmarks.published` adds them to a report",
    },
    "ProjectConfig": {
        "camera.model": "leave it out: `camera.scale` in pixels per unit alone says weak "
        "perspective",
        "camera.rotation": "use `camera.view`, which takes the three rows of a rotation",
        "outliers": "use `corrupt` of `shapefit sweep`, which makes landmarks wrong before a fit",
        "repeat": "leave it out: project several times with different `seed`s",
    },
    "SimulateConfig": {
        "success_below": "leave it out: transforms are recovered below a relative error of 1e-3",
        "published": "leave it out: `python -m benchmarks.published` sets the paper's shares "
        "beside a report",
    },
    "SweepConfig": {
        "corrupt.margin": "leave it out: the box is grown by a tenth of its size",
        "frames": "use `every`",
        "first": "use `offset`",
        "caveats": "leave it out: write them beside the report",
    },
}
"""Schema of a command -> key -> what to do instead, and why."""

OLD_VALUES: Mapping[str, Mapping[tuple[str, str], str]] = {
    "FitConfig": {
        ("method", "alternate+"): "use `method: convex+refine`, which takes `alternation: "
        "{signed: true}` and is the same then",
        ("loss", "l1"): "use `outliers: {method: l1}`",
        ("loss", "sparse-error"): "use `outliers: {method: sparse-error}`",
    },
    "ProjectConfig": {
        ("camera.view", "fixed"): "use the three rows of the rotation as `camera.view`",
    },
}
"""Schema of a command -> key and value -> what to do instead."""


def old_key(places: Iterable[tuple[str, str]]) -> str | None:
    """Return what became of a key, given as (schema, key) for each schema around it."""
    for schema, key in places:
        if key in OLD_KEYS.get(schema, ()):
            return f"{key!r} is no longer a key; {OLD_KEYS[schema][key]}"
    return None


def old_value(places: Iterable[tuple[str, str]], value: Any) -> str | None:
    """Return what became of a value of a key, given as (schema, key) for each schema around it."""
    for schema, key in places:
        if isinstance(value, str) and (key, value) in OLD_VALUES.get(schema, ()):
            return f"{value!r} is no longer a value here; {OLD_VALUES[schema][key, value]}"
    return None
