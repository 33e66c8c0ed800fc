"""How the landmarks of files meet those of the dictionary: by name, or as joints of people.

Detectors of people name their landmarks each in its own way. Where fewer than three names are the
dictionary's, those that a known skeleton takes for its joints get their names.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence

from shapefit.errors import InputError, abbreviate, counted, input_error
from shapefit.io import LandmarkSource
from shapefit.io.records import match_landmarks, nearest_names
from shapefit.io.skeletons import SKELETONS, people_joints, people_weights

FEWEST_LANDMARKS = 3
"""Of a file that the dictionary must know, so that it can do without the others."""


_SIDE = re.compile(r"(?:^|[^a-z])(?:(l)(?:eft)?|(r)(?:ight)?)(?:$|[^a-z])|^(?:(l)|(r))")


def meet_dictionary(
    source: LandmarkSource, known: Sequence[str], rename: Mapping[str, str], place: str
) -> tuple[LandmarkSource, tuple[str, ...]]:
    """Return the source with landmarks named as in the dictionary, and warnings.

    `rename` (in files -> in the dictionary) was applied already, and stays as it is. Raises
    InputError at `place`, with both lists of names and the likely pairs, where fewer than three
    landmarks are the dictionary's.
    """
    own = source.landmark_names
    found = counterparts(own, known, set(rename.values()))
    if found:
        source = source.renamed(found, people_weights(found))
        strange = find_strange(source.landmark_names, known)
        return source, (_taken_as_joints(own, found, strange),)
    strange = find_strange(own, known)
    if not strange and not set(own) <= set(known):
        raise _unmatched(own, known, place)
    return source, left_out_landmarks(strange, known)


def counterparts(
    own: Sequence[str], known: Sequence[str], renamed: set[str] | frozenset[str] = frozenset()
) -> dict[str, str]:
    """Return which landmarks are joints of people that the dictionary knows by other names.

    Empty where three names or more are the dictionary's without `renamed`, or where fewer than
    three joints would be found.
    """
    if len(set(own) & set(known) - renamed) >= FEWEST_LANDMARKS:
        return {}
    joints = people_joints(name for name in own if name not in renamed)
    free = set(known) - set(own)
    count = Counter(joints.values())
    found = {name: joint for name, joint in joints.items() if joint in free and count[joint] == 1}
    return found if len(found) >= FEWEST_LANDMARKS else {}


def find_strange(own: Sequence[str], known: Sequence[str]) -> list[str]:
    """List the landmarks that the dictionary lacks and a fit can do without: three others match."""
    strange = [name for name in own if name not in set(known)]
    return strange if len(own) - len(strange) >= FEWEST_LANDMARKS else []


def left_out_landmarks(strange: Sequence[str], known: Sequence[str]) -> tuple[str, ...]:
    """Warn of landmarks that the dictionary lacks, with the names that they may mean."""
    if not strange:
        return ()
    hint = _likely_pairs(strange, known)
    text = f"; if they are the same: {hint}" if hint else ""
    found = f"{counted(len(strange), 'landmark')} left out, which the dictionary lacks"
    return (f"{found} ({abbreviate(strange)}){text}",)


def _taken_as_joints(own: Sequence[str], found: Mapping[str, str], strange: Sequence[str]) -> str:
    """Say which skeleton was recognised, and what of it has no counterpart."""
    shared = {
        name: len(set(own) & set(preset.landmark_names)) for name, preset in SKELETONS.items()
    }
    skeleton = max(shared, key=lambda name: shared[name])
    text = f"{counted(len(found), 'landmark')} of {skeleton} taken as joints of the dictionary"
    if not strange:
        return text
    return f"{text}; {len(strange)} without a counterpart left out ({abbreviate(strange)})"


def _unmatched(own: Sequence[str], known: Sequence[str], place: str) -> InputError:
    """Return the error for landmarks of which too few are the dictionary's."""
    matching = [name for name in own if name in set(known)]
    if {name.strip() for name in own} & set(known) - set(matching):
        try:
            match_landmarks(known, own, place)  # which names spaces around names
        except InputError as error:
            return error
    found = (
        f"{len(matching)} of the {counted(len(own), 'landmark')} of the files are in the "
        f"dictionary, and {FEWEST_LANDMARKS} must be; the files have {', '.join(own)}; the "
        f"dictionary has {', '.join(known)}"
    )
    pairs = _likely_pairs([name for name in own if name not in set(known)], known)
    return input_error(place, found, f"name them alike: {pairs or '`rename: {FILE: DICTIONARY}`'}")


def _likely_pairs(strange: Sequence[str], known: Sequence[str]) -> str:
    """Return a `rename` of the names that look most alike; "" where none do."""
    near = {
        name: [each for each in nearest_names(name, known) if not _opposite(name, each)]
        for name in strange
    }
    pairs = [f"{name}: {close[0]}" for name, close in near.items() if close]
    return f"`rename: {{{', '.join(pairs[:5])}}}`" if pairs else ""


def _opposite(name: str, other: str) -> bool:
    """Whether one name is of a left landmark, and the other of a right one."""
    found = [_SIDE.search(each.lower()) for each in (name, other)]
    sides = {match[match.lastindex or 0] for match in found if match}
    return sides == {"l", "r"}
