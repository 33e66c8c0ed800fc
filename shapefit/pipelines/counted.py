"""A number with its noun."""

from __future__ import annotations


def counted(number: int, noun: str) -> str:
    """Return `1 atom`, `2 atoms`; for nouns whose plural ends in s."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def nothing_in(count: int, unit: str) -> tuple[str, ...]:
    """Warn of inputs that hold nothing."""
    return () if count else (f"the input holds no {unit}",)
