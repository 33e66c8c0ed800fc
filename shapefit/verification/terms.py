"""The terms of a fit: what its config says of the numbers in its result."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shapefit.errors import input_error
from shapefit.io import ResultSet

NEW_SECTIONS: dict[str, Any] = {
    "search": {"signed": False, "modes": 0, "proof_every": 0},
    "posterior": {"covariance": False},
    "sequences": {"frame_rate": None},
    "rotations": "shared",
    "input": {},
}
"""What configs of version 0.1.0 lack, which have the losses `l1` and `sparse-error`, and `beta`."""

DONE = ("optimal", "converged")

CONVEX = "convex"
REFINED = "convex+refine"
STARTED = ("posterior", "sequences")
LOOKING = ("posterior", "sequences")
"""Methods that look through a camera themselves, without coefficients."""

LOCAL = "alternate"
GLOBAL = "global"
QUADRATIC = ("squared", "sparse-error")
ROBUST = ("l1", "sparse-error")
DEFAULT_THRESHOLD = 0.1
"""Of a robust loss whose config gives none."""


@dataclass(frozen=True)
class Terms:
    """What a result was to be.

    method, loss, beta and tolerance as in the config; lam None where it is `auto`; orthogonal: the
    transforms were replaced by nearest rotations; left_out: the dataset that names the atoms left
    out, '' for none; searched: outliers were looked for before the fit; perspective: refined under
    a camera; least_score: landmarks of less confidence are hidden, the others weigh alike; signed:
    the global optimum is one over coefficients of either sign; noise: of the landmarks, from which
    lambda comes; transforms, modes, trees, covariance: whether these were to be stored; frame_rate
    where the config has one; calibrated: the camera comes from a file of its own; strict: what is
    not optimal counts as failed; input: how the landmarks were read; dictionary and landmarks: the
    files of the fit; inputs: their digests.
    """

    method: str
    loss: str
    beta: float
    lam: float | None
    tolerance: float
    orthogonal: bool
    left_out: str
    searched: bool
    perspective: bool
    least_score: float | None
    signed: bool
    noise: float
    transforms: bool
    modes: bool
    trees: bool
    covariance: bool
    frame_rate: float | None
    calibrated: bool
    strict: bool
    input: Mapping[str, Any]
    dictionary: str
    landmarks: tuple[str, ...]
    inputs: Mapping[str, str]

    @property
    def has_program(self) -> bool:
        """Whether the method solves the convex program, and so has a proof."""
        return self.method == CONVEX or self.method in (REFINED, *STARTED)

    @property
    def is_program(self) -> bool:
        """Whether objective and shapes are those of the convex program itself."""
        return self.method == CONVEX and not self.perspective

    @property
    def is_global(self) -> bool:
        """Whether objective and shapes are those of the optimum over all rotations."""
        return self.method == GLOBAL and not self.perspective

    @property
    def has_one_rotation(self) -> bool:
        """Whether the shapes are R sum_i c_i B_i with the rotation and coefficients stored."""
        refined = self.perspective and self.method not in LOOKING
        return refined or self.method in (REFINED, LOCAL, GLOBAL)

    @property
    def weighs_atoms(self) -> bool:
        """Whether the shapes are made of coefficients."""
        return self.has_one_rotation or self.method in (CONVEX, "pmp")

    @property
    def has_gap(self) -> bool:
        """Whether the objective of every image has a gap to a bound."""
        refined = self.method == REFINED and self.loss == "squared" and not self.perspective
        return self.is_program or self.is_global or refined

    @property
    def bound(self) -> float:
        """Bound on the entries of the dual."""
        return {"l1": 1.0, "sparse-error": self.beta}.get(self.loss, float("inf"))

    @property
    def quadratic(self) -> bool:
        """Whether the dual objective has the term -1/2 ||Y||^2."""
        return self.loss in QUADRATIC


def read_terms(attributes: Mapping[str, Any], file: Path) -> Terms:
    """Return the terms that the attribute `config` of a result states.

    Raises InputError where there is no such text, or it lacks what a config of `fit` has.
    """
    fix = "give a result that `shapefit fit` wrote"
    try:
        config = NEW_SECTIONS | json.loads(str(attributes["config"]))
        lam, search, posterior = config["lambda"], config["search"], config["posterior"]
        robust, threshold = config["outliers"]["method"], config["outliers"]["threshold"]
        return Terms(
            method=str(config["method"]),
            loss=robust if robust in ROBUST else str(config["loss"]),
            beta=float(config.get("beta", DEFAULT_THRESHOLD if threshold is None else threshold)),
            lam=None if lam == "auto" else float(lam),
            tolerance=float(config["solver"]["tolerance"]),
            orthogonal=config["rotations"] == "orthogonal",
            left_out=config["leave_out"] or "",
            searched=robust not in ("none", *ROBUST),
            perspective=config["camera"]["model"] == "perspective",
            least_score=_least_score(config),
            signed=bool(search["signed"]),
            noise=float(config["noise"] or 0.0),
            transforms=bool(config["transforms"]),
            modes=bool(search["modes"]),
            trees=bool(search["proof_every"]),
            covariance=bool(posterior["covariance"]),
            frame_rate=config["sequences"]["frame_rate"],
            calibrated=config["camera"]["calibration"] is not None,
            strict=bool(config["strict"]),
            input=read_as(config),
            dictionary=str(config["dictionary"]),
            landmarks=tuple(map(str, config["landmarks"])),
            inputs=dict(json.loads(str(attributes.get("inputs", "{}")))),
        )
    except (KeyError, TypeError, ValueError) as error:
        wrong = f"{type(error).__name__}: {error}"
        found = f"its attributes `config` and `inputs` are not those of a fit ({wrong})"
        raise input_error(file, found, fix) from None


def _least_score(config: Mapping[str, Any]) -> float | None:
    """Return the score from which on landmarks count alike; None for weights as they are."""
    least = config["posterior"].get("least_score")
    return None if least is None or config["method"] not in STARTED else float(least)


def read_as(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return how the fit read its landmarks; detections became sequences where it needed those."""
    default = "nearest" if config["method"] == "sequences" else "none"
    return config["input"] | {"track": config["input"].get("track") or default}


def lacks_proof(result: ResultSet) -> bool:
    """Whether a result of the convex program lacks its dual or its transforms."""
    parts = (result.dual, result.convex_translation, result.transform_count)
    return any(part is None for part in (*parts, result.transform_atom, result.active_transforms))
