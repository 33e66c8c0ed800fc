"""The table of methods: what each needs of a dictionary, reads from the config, and
runs.

It is light, and stands below the methods themselves, which are imported where they are
chosen: the config, the chain of `fit`, the exports and the page of a result ask the
table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from shapefit.errors import listed

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from shapefit.convex.problem import Problem
    from shapefit.convex.solver import Solution
    from shapefit.dictionary.model import Dictionary
    from shapefit.lifting.estimate import Estimate, Estimator
    from shapefit.lifting.posterior.usual_lengths import LimbLengths

    Solve = Callable[[Problem], Solution]
    Run = Callable[[Problem, "Settings"], Estimate]

BASES = "pca-bases"
"""How a dictionary is learned whose coefficients may have either sign."""

ATOMS = ("sparse-coding", "exemplars")
"""How dictionaries are learned whose shapes are sums without sign."""

STARTS = 6
"""Views from which the pose of the mean shape is sought; the paper has one."""


@dataclass(frozen=True, kw_only=True)
class PosteriorOptions:
    """The model of the landmarks, and what is reported.

    residual_variance  variance that the model cannot explain, of a coordinate in the
                       unit of
                   normalised shapes, at confidence 1
    outlier_rate   chance that a landmark is an outlier; 0 believes all
    outlier_density  density of outliers per area, for normalised landmarks
    bar_scale       factor of all covariances, for bodies and motions that the prior
                    lacks
    growth         factors (p,) of the covariances of landmarks beyond it, by a sample
                   of the file;
                   empty for none
    covariance     whether the covariance of all landmarks together is wanted
    limbs          usual lengths that the limbs of single images are to have; None for
                   no such
    """

    residual_variance: float = 0.01
    outlier_rate: float = 0.02
    outlier_density: float = 0.05
    bar_scale: float = 1.0
    growth: tuple[float, ...] = ()
    covariance: bool = False
    limbs: LimbLengths | None = None


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What the methods need besides the problem; each reads what concerns it.

    solve            solver of the convex program
    mean_shape       (3, p) of the dictionary
    needs            what else of the dictionary the method needs, by name
    signed           convex+refine and alternate: coefficients of either sign
    starts           alternate and mean-shape: views from which the pose is sought
    posterior        posterior and sequences: the model of the landmarks
    tolerance        global: the relative gap at which an image is solved
    threads          0 is one per core
    """

    solve: Solve
    mean_shape: NDArray[np.float64]
    needs: dict[str, Any] = field(default_factory=dict)
    signed: bool = False
    starts: int = STARTS
    posterior: PosteriorOptions = PosteriorOptions()
    tolerance: float = 1e-2
    threads: int = 0


class Need(NamedTuple):
    """A field of the dictionary that a method cannot do without, and how to get one
    that has it.

    useless    says what is wrong with the field of a dictionary that has it; "" for
               nothing
    """

    name: str
    what: str
    fix: str
    useless: Callable[[Dictionary], str] = lambda _: ""


def lacks_limbs(dictionary: Dictionary) -> str:
    """Say what keeps the edges from fixing the size of a skeleton: none of them has a
    length.
    """
    assert dictionary.edges is not None  # check_needs
    if len(dictionary.edges) == 0:
        return "`edges` is empty"
    start, end = dictionary.edges.T
    limbs = dictionary.mean_shape[:, start] - dictionary.mean_shape[:, end]
    return "" if (limbs**2).sum() > 0 else "every edge of `mean_shape` has length 0"


class Method(NamedTuple):
    """A way to lift, and all that the rest of the package knows about it.

    run            "module:function", takes a Problem and Settings to an Estimate
    summary        what it does: a clause of the help
    losses         data terms that it knows
    learned        how the dictionary must be learned, by `method` of learn-dict; empty
                   for any
    needs          fields of the dictionary without which it cannot run
    proves         "optimum": it is the convex program, and its certificate is that of
                   the result;
                   "bound": it starts from the convex program, whose proof is stored
                   beside it; "global": it is the optimum with one rotation, and its
                   certificate that of the result; what proves it is stored on request;
                   "nothing": a local method
    mixes_atoms    shapes are R sum_i c_i B_i (or sum_i c_i R_i B_i), so that whatever
                   belongs to
                   the atoms, as their meshes, can be mixed alike
    perspective    "refined": under a perspective camera it is followed by a refinement;
                   "own": it
                   looks through the camera itself; "none"
    sequences      lifts whole sequences: its images are followed by the stage of
                   sequences
    precisions     a confidence only says whether a landmark was seen, see
                   `min_confidence`
    has_starts     it seeks the pose of the mean shape from as many views as `starts`
                   says
    tolerance      the default of `tolerance`
    """

    run: str
    summary: str
    losses: tuple[str, ...] = ("squared",)
    learned: tuple[str, ...] = ATOMS
    needs: tuple[Need, ...] = ()
    proves: Literal["optimum", "bound", "global", "nothing"] = "nothing"
    mixes_atoms: bool = True
    perspective: Literal["refined", "own", "none"] = "refined"
    sequences: bool = False
    precisions: bool = False
    has_starts: bool = False
    tolerance: float = 1e-6

    @property
    def has_prior(self) -> bool:
        """Whether it needs a prior over shapes."""
        return PRIOR in self.needs


ROBUST = ("l1", "sparse-error")

AUTO = "auto"
"""Not a method: that which suits dictionary and images."""

MIN_CONFIDENCE = 0.1
"""Landmarks of a lower confidence are hidden, by methods that take others as equally
precise.
"""

PRIOR = Need(
    "prior",
    "the prior over shapes that posterior weighs the landmarks against",
    "learn it by `shapefit learn-dict --prior`",
)

POSTERIOR = Method(
    run="shapefit.lifting.posterior.method:lift_to_posterior",
    summary="the posterior mean under the prior over shapes, with its uncertainty",
    needs=(PRIOR,),
    proves="bound",
    mixes_atoms=False,
    precisions=True,
    perspective="own",
    tolerance=1e-3,
)

METHODS: dict[str, Method] = {
    "convex": Method(
        run="shapefit.lifting.reconstruction:lift_convex",
        summary="the convex program",
        losses=("squared", "exact", *ROBUST),
        proves="optimum",
    ),
    "convex+refine": Method(
        run="shapefit.lifting.shared_rotation:refine_convex",
        summary="its solution refined to one shared rotation",
        losses=("squared", *ROBUST),
        proves="bound",
    ),
    "global": Method(
        run="shapefit.lifting.global_optimum:find_global",
        summary="the certified optimum over all rotations shared by the atoms",
        proves="global",
        tolerance=1e-2,
    ),
    "alternate": Method(
        run="shapefit.lifting.shared_rotation:alternate_from_mean",
        summary="alternating minimisation from the mean shape",
        has_starts=True,
    ),
    "pmp": Method(
        run="shapefit.lifting.matching_pursuit:lift_by_pursuit",
        summary="projected matching pursuit with PCA bases",
        learned=(BASES,),
        needs=(
            Need(
                "edges",
                "the limbs whose lengths pmp keeps",
                "learn it with `method: pca-bases` from shapes with edges",
                lacks_limbs,
            ),
        ),
        mixes_atoms=False,
        perspective="none",
    ),
    "mean-shape": Method(
        run="shapefit.lifting.shared_rotation:pose_mean_shape",
        summary="the pose of the mean shape alone",
        learned=(),
        mixes_atoms=False,
        has_starts=True,
    ),
    "posterior": POSTERIOR,
    "sequences": POSTERIOR._replace(
        run="shapefit.lifting.sequences.clips:lift_frames",
        summary="the posterior of whole sequences: rigid bones, smooth motion",
        sequences=True,
    ),
}


def summarise() -> str:
    """Return what each method does, for the help: `name`, summary; and so on."""
    return "; ".join(f"`{name}`, {method.summary}" for name, method in METHODS.items())


def choose_method(name: str, settings: Settings) -> Estimator:
    """Return the method of that name with its settings, as `lift` wants it."""
    module, _, function = METHODS[name].run.partition(":")
    run: Run = getattr(import_module(module), function)
    return lambda problem: run(problem, settings)


def find_conflict(fit: Any) -> str | None:
    """Return the key of a config of `fit` that its method cannot use; None where there
    is none.
    """
    if fit.method == AUTO:
        return None
    name, method = fit.method, METHODS[fit.method]
    given = fit.model_fields_set
    of_prior = [f"prior.{key}" for key in sorted(fit.prior.model_fields_set)]
    of_prior += ["skeleton"] if "skeleton" in given and fit.skeleton is not None else []
    of_prior += ["save.covariance"] if fit.save.covariance else []
    if fit.outliers in ROBUST and fit.outliers not in method.losses:
        fault, fix = (
            f"does not support `outliers: {fit.outliers}`",
            "use `method: convex`",
        )
    elif fit.leave_one_out and method.has_prior:
        fault = (
            "has a prior that was learned from all shapes; `leave_one_out` needs"
            " another"
        )
        fix = "use another method, or a dictionary learned without the shapes"
    elif fit.camera.focal not in ("auto", "none") and method.perspective == "none":
        fault, fix = "has no perspective camera", "leave out `camera.focal`"
    elif of_prior and not method.has_prior:
        priors = _name_methods(lambda row: row.has_prior)
        fault, fix = (
            f"has no prior; `{of_prior[0]}` needs one",
            f"use {priors}, or leave it out",
        )
    elif "starts" in given and not method.has_starts:
        fault = "does not support `starts`"
        fix = f"use {_name_methods(lambda row: row.has_starts)}, or leave it out"
    else:
        return None
    return f"the method {name} {fault}; {fix}"


def _name_methods(suits: Callable[[Method], bool]) -> str:
    """Return the methods whose row suits, as a message names them."""
    return listed(f"`method: {name}`" for name, row in METHODS.items() if suits(row))
