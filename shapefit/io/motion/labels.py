"""Labels of markers as names of landmarks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from shapefit.errors import abbreviate, counted


def unique_names(labels: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return labels as names that occur once, and a note on those that had to change.

    A point without a label is `*7`, as C3D files call the eighth; what repeats gets a number.
    """
    names = [label.strip() or f"*{place}" for place, label in enumerate(labels)]
    taken, seen = set(names), Counter[str]()
    changed = []
    for place, name in enumerate(names):
        seen[name] += 1
        if seen[name] > 1:
            number = seen[name]
            while f"{name}_{number}" in taken:
                number += 1
            names[place] = f"{name}_{number}"
            taken.add(names[place])
            changed.append(names[place])
    if not changed:
        return tuple(names), ()
    note = f"{counted(len(changed), 'label')} repeated, and numbered ({abbreviate(changed)})"
    return tuple(names), (note,)
