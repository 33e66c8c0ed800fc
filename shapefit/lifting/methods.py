"""The table of methods: what each does, needs of a dictionary, and proves.

It is light, and stands below the methods themselves, which are imported where they are
chosen: the config, the exports and the page of a result ask the table.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Literal, NamedTuple

if TYPE_CHECKING:
    from shapefit.dictionary.model import Dictionary

BASES = "pca-bases"
"""How a dictionary is learned whose coefficients may have either sign."""

ATOMS = ("sparse-coding", "exemplars")
"""How dictionaries are learned whose shapes are sums without sign."""

STARTS = 6
"""Views from which the pose of the mean shape is sought; the paper has one."""

MIN_CONFIDENCE = 0.1
"""Landmarks of a lower confidence are hidden, by methods that take others as equally
precise.
"""

ROBUST = ("l1", "sparse-error")
"""Losses that find outliers."""

AUTO = "auto"
"""Not a method: that which suits dictionary and images."""


class Need(NamedTuple):
    """A field of the dictionary that a method cannot do without.

    name       of the field
    what       the field is for, in words
    fix        how to get a dictionary that has it
    find_fault returns what is wrong with the field of a dictionary that has it, "" for
               nothing
    """

    name: str
    what: str
    fix: str
    find_fault: Callable[[Dictionary], str] = lambda _: ""


def find_fault_of_edges(dictionary: Dictionary) -> str:
    """Say why edges have no length: there are none, or all have length 0; else "".

    The dictionary must have the array of edges.
    """
    assert dictionary.edges is not None  # check_needs
    if len(dictionary.edges) == 0:
        return "`edges` is empty"
    start, end = dictionary.edges.T
    limbs = dictionary.mean_shape[:, start] - dictionary.mean_shape[:, end]
    return "" if (limbs**2).sum() > 0 else "every edge of `mean_shape` has length 0"


class Method(NamedTuple):
    """A way to lift, and all that config, help and commands know about it.

    summary, what it does: a clause of the help; losses, data terms that it knows;
    learned, how the dictionary must be learned, by `method` of learn-dict, empty for
    any; needs, fields of the dictionary without which it cannot run; tolerance, the
    default of `tolerance`; has_starts, it seeks the pose of the mean shape from as many
    views as `starts` says; takes_sequences, it lifts whole sequences.

    proves: "optimum", it is the convex program, and its certificate is that of the
    result; "bound", it starts from the convex program, whose proof is stored beside it;
    "global", it is the optimum with one rotation, and its certificate that of the
    result; "nothing", a local method. What proves it is stored on request.

    mixes_atoms: shapes are R sum_i c_i B_i (or sum_i c_i R_i B_i), so that whatever
    belongs to the atoms, as their meshes, can be mixed alike. perspective: "refined",
    under a perspective camera it is followed by a refinement; "own", it looks through
    the camera itself; "none".
    """

    summary: str
    losses: tuple[str, ...] = ("squared",)
    learned: tuple[str, ...] = ATOMS
    needs: tuple[Need, ...] = ()
    proves: Literal["optimum", "bound", "global", "nothing"] = "nothing"
    mixes_atoms: bool = True
    perspective: Literal["refined", "own", "none"] = "refined"
    takes_sequences: bool = False
    has_starts: bool = False
    tolerance: float = 1e-6

    @property
    def needs_prior(self) -> bool:
        """Whether the method needs a prior over shapes."""
        return PRIOR in self.needs


PRIOR = Need(
    "prior",
    "the prior over shapes that posterior weighs the landmarks against",
    "learn it by `shapefit learn-dict --prior`",
)

POSTERIOR = Method(
    summary="the posterior mean under the prior over shapes, with its uncertainty",
    needs=(PRIOR,),
    proves="bound",
    mixes_atoms=False,
    perspective="own",
    tolerance=1e-3,
)

METHODS: dict[str, Method] = {
    "convex": Method(
        summary="the convex program",
        losses=("squared", "exact", *ROBUST),
        proves="optimum",
    ),
    "convex+refine": Method(
        summary="its solution refined to one shared rotation",
        losses=("squared", *ROBUST),
        proves="bound",
    ),
    "global": Method(
        summary="the certified optimum over all rotations shared by the atoms",
        proves="global",
        tolerance=1e-2,
    ),
    "alternate": Method(
        summary="alternating minimisation from the mean shape",
        has_starts=True,
    ),
    "pmp": Method(
        summary="projected matching pursuit with PCA bases",
        learned=(BASES,),
        needs=(
            Need(
                "edges",
                "the limbs whose lengths pmp keeps",
                "learn it with `method: pca-bases` from shapes with edges",
                find_fault_of_edges,
            ),
        ),
        mixes_atoms=False,
        perspective="none",
    ),
    "mean-shape": Method(
        summary="the pose of the mean shape alone",
        learned=(),
        mixes_atoms=False,
        has_starts=True,
    ),
    "posterior": POSTERIOR,
    "sequences": POSTERIOR._replace(
        summary="the posterior of whole sequences: rigid bones, smooth motion",
        takes_sequences=True,
    ),
}


def summarise() -> str:
    """Return one text for the help: the name of each method, and its summary."""
    return "; ".join(f"`{name}`, {method.summary}" for name, method in METHODS.items())
