"""Which landmarks of files a dictionary knows, and what is said of the others."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from shapefit.errors import abbreviate, counted, input_error
from shapefit.io.landmark_names import match_landmarks, nearest_names
from shapefit.io.skeletons import people_joints
from shapefit.pipelines.skeletons.joints import Joints, find_joints

FEWEST_LANDMARKS = 3
"""Of a file that the dictionary must know, so that it can do without the others."""

_SIDE = re.compile(r"(?:^|[^a-z])(?:(l)(?:eft)?|(r)(?:ight)?)(?:$|[^a-z])|^(?:(l)|(r))")


def match_names(
    own: Sequence[str], known: Sequence[str], place: str, *, in_place: bool
) -> tuple[Joints, list[str]]:
    """Return the joints that landmarks stand for, and the landmarks that a fit can do without.

    Raises InputError as `check_enough`.
    """
    joints = find_joints(own, known, in_place=in_place)
    renamed = joints.rename(own)
    check_enough(renamed, known, place)
    return joints, find_strange(renamed, known)


def find_strange(own: Sequence[str], known: Sequence[str]) -> list[str]:
    """List the landmarks that the dictionary lacks and a fit can do without: three others match."""
    strange = [name for name in own if name not in set(known)]
    return strange if len(own) - len(strange) >= FEWEST_LANDMARKS else []


def check_enough(own: Sequence[str], known: Sequence[str], place: str) -> None:
    """Raise InputError where fewer than three landmarks are the dictionary's, and others are not.

    The error has both lists of names, and the pairs that look alike where these are enough.
    """
    matching = [name for name in own if name in set(known)]
    if len(matching) >= FEWEST_LANDMARKS or len(matching) == len(own):
        return
    if {name.strip() for name in own} & set(known) - set(matching):
        match_landmarks(known, own, place)  # which names spaces around names
    if twice := _same_joint(own):
        found = f"landmarks of several skeletons: {twice[0]} and {twice[1]} are one joint of people"
        raise input_error(place, found, "give the files of each skeleton in a separate call")
    found = (
        f"{len(matching)} of the {counted(len(own), 'landmark')} of the files are in the "
        f"dictionary, and {FEWEST_LANDMARKS} must be; the files have {', '.join(own)}; the "
        f"dictionary has {', '.join(known)}"
    )
    pairs = _likely_pairs(
        [name for name in own if name not in set(known)],
        [name for name in known if name not in set(own)],
    )
    if len(matching) + len(pairs) >= FEWEST_LANDMARKS:
        raise input_error(place, found, f"name them alike: {_as_rename(pairs)}")
    fix = "give a dictionary of such objects, or name landmarks alike: `rename: {FILE: DICTIONARY}`"
    raise input_error(place, found, fix)


def _same_joint(own: Sequence[str]) -> list[str]:
    """Return the first landmarks that stand for the same joint of people; none where none do."""
    names: dict[str, list[str]] = {}
    for name, joint in people_joints(own).items():
        names.setdefault(joint, []).append(name)
    return next((several for several in names.values() if len(several) > 1), [])


def name_warnings(own: Sequence[str], known: Sequence[str]) -> tuple[str, ...]:
    """Say which landmarks are left out; those of a known skeleton are expected."""
    joints = find_joints(own, known)
    if joints.names:
        return ()
    strange = find_strange(own, known)
    return left_out_landmarks(strange, [name for name in known if name not in set(own)])


def said_of_names(own: Sequence[str], known: Sequence[str]) -> str:
    """Say how many landmarks stand for joints of the dictionary; nothing where none do."""
    joints = find_joints(own, known)
    taken = sum(map(len, joints.stand_ins.values()))
    return f"{taken} of {counted(len(own), 'landmark')} taken for joints of people" if taken else ""


def left_out_landmarks(strange: Sequence[str], known: Sequence[str]) -> tuple[str, ...]:
    """Warn of landmarks that the dictionary lacks, with the names that they may mean."""
    if not strange:
        return ()
    pairs = _likely_pairs(strange, known)
    hint = f"; if they are the same: {_as_rename(pairs)}" if pairs else ""
    found = f"{counted(len(strange), 'landmark')} left out, which the dictionary lacks"
    return (f"{found} ({abbreviate(strange)}){hint}",)


def _likely_pairs(strange: Sequence[str], known: Sequence[str]) -> dict[str, str]:
    """Return the names that look most alike, the file's to the dictionary's."""
    near = {
        name: [each for each in nearest_names(name, known) if not _opposite(name, each)]
        for name in strange
    }
    return {name: close[0] for name, close in near.items() if close}


def _as_rename(pairs: Mapping[str, str]) -> str:
    """Return the first pairs as the key `rename`."""
    first = [f"{name}: {meant}" for name, meant in list(pairs.items())[:5]]
    return f"`rename: {{{', '.join(first)}}}`"


def _opposite(name: str, other: str) -> bool:
    """Whether one name is of a left landmark, and the other of a right one."""
    found = [_SIDE.search(each.lower()) for each in (name, other)]
    sides = {match[match.lastindex or 0] for match in found if match}
    return sides == {"l", "r"}
