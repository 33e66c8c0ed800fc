"""The terms of a fit: what its config says of the numbers in its result."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shapefit.errors import input_error
from shapefit.io import ResultSet

CONVEX = "convex"
REFINED = ("convex+refine", "alternate+")
STARTED = ("posterior", "sequences")
LOOKING = ("posterior", "sequences")
"""Methods that look through a camera themselves, without coefficients."""

LOCAL = ("alternate",)
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
    a camera; depths: refined along sequences; by_change: solved to a stop of the changes; path:
    solved along lambdas; signed: the global optimum is one over coefficients of either sign;
    dictionary and landmarks: the files of the fit; inputs: their digests.
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
    depths: bool
    by_change: bool
    path: bool
    signed: bool
    dictionary: str
    landmarks: tuple[str, ...]
    inputs: Mapping[str, str]

    @property
    def has_program(self) -> bool:
        """Whether the method solves the convex program, and so has a proof."""
        return self.method == CONVEX or self.method in (*REFINED, *STARTED)

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
        return refined or self.method in (*REFINED, *LOCAL, GLOBAL)

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
        config = json.loads(str(attributes["config"]))
        lam = config["lambda"]
        return Terms(
            method=str(config["method"]),
            loss=_data_term(config),
            beta=_bound_of_errors(config),
            lam=None if lam == "auto" else float(lam),
            tolerance=float(config["solver"]["tolerance"]),
            orthogonal=config.get("rotations") == "orthogonal" or bool(config.get("orthogonal")),
            left_out=config["leave_out"] or "",
            searched=config["outliers"]["method"] not in ("none", *ROBUST),
            perspective=config["camera"]["model"] == "perspective",
            depths=bool(config.get("temporal", {}).get("depths")),
            by_change=config["solver"].get("stop") == "change",
            path=bool(config.get("path")),
            signed=bool(config.get("search", {}).get("signed", False)),
            dictionary=str(config["dictionary"]),
            landmarks=tuple(map(str, config["landmarks"])),
            inputs=dict(json.loads(str(attributes.get("inputs", "{}")))),
        )
    except (KeyError, TypeError, ValueError) as error:
        wrong = f"{type(error).__name__}: {error}"
        found = f"its attributes `config` and `inputs` are not those of a fit ({wrong})"
        raise input_error(file, found, fix) from None


def _data_term(config: Mapping[str, Any]) -> str:
    """Return the loss of the program; in results of version 0.1.0 it is the key `loss` always."""
    method = str(config["outliers"]["method"])
    return method if method in ROBUST else str(config["loss"])


def _bound_of_errors(config: Mapping[str, Any]) -> float:
    """Return the weight of sparse errors; in results of version 0.1.0 it is the key `beta`."""
    if "beta" in config:
        return float(config["beta"])
    threshold = config["outliers"]["threshold"]
    return DEFAULT_THRESHOLD if threshold is None else float(threshold)


def lacks_proof(result: ResultSet) -> bool:
    """Whether a result of the convex program lacks its dual or its transforms."""
    parts = (result.dual, result.convex_translation, result.transform_count)
    return any(part is None for part in (*parts, result.transform_atom, result.active_transforms))
