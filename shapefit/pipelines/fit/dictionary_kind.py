"""Whether the dictionary is of the kind that the method of a fit is made for."""

from __future__ import annotations

from shapefit.config import FitConfig
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.lifting.methods import METHODS


def check_needs(config: FitConfig, dictionary: Dictionary) -> None:
    """Raise InputError where the dictionary lacks what the method needs, or it is of no use."""
    for need in METHODS[config.method].needs:
        missing = getattr(dictionary, need.name) is None
        found = f"no `{need.name}`" if missing else need.useless(dictionary)
        if found:
            raise input_error(config.dictionary, f"{found}: {need.what}", need.fix)


def mismatch(config: FitConfig, dictionary: Dictionary) -> tuple[str, ...]:
    """Return a warning where the method is made for dictionaries that were learned otherwise.

    A dictionary that does not state how it was learned passes, and any where signs are free.
    """
    learned = dictionary.provenance.get("method")
    wanted = METHODS[config.method].learned
    if learned is None or not wanted or config.alternation.signed or learned in wanted:
        return ()
    kinds = " or ".join(f"`{kind}`" for kind in wanted)
    if len(wanted) == 1:
        kinds = f"`method: {wanted[0]}`"
    found = f"the dictionary was learned with `method: {learned}`"
    return (f"{found}; {config.method} is made for {kinds}",)
