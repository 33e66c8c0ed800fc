"""What the outcomes of a run tell, put together."""

from collections.abc import Iterable

from shapefit.pipelines.result import Counted, Result


def done(outcomes: Iterable[Result]) -> int:
    """Count the items that were done."""
    return sum(outcome.done for outcome in outcomes)


def failures(outcomes: Iterable[Result]) -> dict[str, str]:
    """Return the items that failed, each once, and why."""
    told = [each for outcome in outcomes for each in outcome.failures]
    reasons = {each.item: each.reason for each in told}
    assert len(reasons) == len(told)
    return reasons


def warnings(outcomes: Iterable[Result]) -> list[str | Counted]:
    """Return all warnings."""
    return [warning for outcome in outcomes for warning in outcome.warnings]


def texts(outcomes: Iterable[Result]) -> list[str]:
    """Return the text of each warning."""
    return list(map(str, warnings(outcomes)))
