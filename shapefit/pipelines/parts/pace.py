"""How far the parts of a run are, how fast they go, and how long the rest will take."""

from __future__ import annotations

from shapefit.errors import counted

MINUTE, HOUR = 60, 3600


def tell_pace(reached: int, parts: int, lost: int, images: int, ended: int, seconds: float) -> str:
    """Return one line: `12 of 40 parts done, 1 failed, 34,500 images/s, 3 min left`.

    reached   parts that are done, those of earlier runs included
    lost      parts that failed
    images    lifted by this run, in the `ended` parts that it did, within `seconds`
    """
    words = [f"{reached} of {counted(parts, 'part')} done"]
    if lost:
        words.append(f"{lost} failed")
    if images and seconds > 0:
        words.append(f"{images / seconds:,.0f} images/s")
    left = parts - reached - lost
    if left and ended:
        words.append(f"{_duration(left * seconds / ended)} left")
    return ", ".join(words)


def _duration(seconds: float) -> str:
    if seconds < MINUTE:
        return f"{seconds:.0f} s"
    if seconds < HOUR:
        return f"{seconds / MINUTE:.0f} min"
    return f"{seconds / HOUR:.1f} h"
