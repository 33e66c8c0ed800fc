"""Whether the dictionary is of the kind that the method of a fit is made for."""

from __future__ import annotations

from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary

BASES = "pca-bases"
"""How a dictionary is learned whose coefficients may have either sign."""


def mismatch(config: FitConfig, dictionary: Dictionary) -> tuple[str, ...]:
    """Return a warning where bases of either sign meet a method of sums without sign, or atoms pmp.

    A dictionary that does not tell how it was learned passes.
    """
    learned = dictionary.provenance.get("method")
    takes_either = config.method == "mean-shape" or config.alternation.signed
    if learned is None or takes_either or (learned == BASES) == (config.method == "pmp"):
        return ()
    wanted = f"`method: {BASES}`" if config.method == "pmp" else "`sparse-coding` or `exemplars`"
    found = f"the dictionary was learned with `method: {learned}`"
    return (f"{found}; {config.method} is made for {wanted}",)
