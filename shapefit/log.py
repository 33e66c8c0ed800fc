"""Messages for developers and clusters, by the `logging` of the standard library.

They are at the level DEBUG, of loggers below `shapefit`; at the level TRACE the convex
solver also states each of its iterations. Nobody hears them but who asks for them: in
Python by `logging`, on the command line by `SHAPEFIT_LOG=debug` or `SHAPEFIT_LOG=trace`
in the environment. As long as nobody does, `logging` is not imported here.
"""

from __future__ import annotations

import os
import sys

TRACE = 5
"""A level below DEBUG (10), at which the solver states each iteration."""

ENVIRONMENT_KEY = "SHAPEFIT_LOG"
"""Variable that asks for messages on standard error."""

LEVELS = {"debug": 10, "trace": TRACE}
"""Its values, and the levels of `logging` for which they stand."""


def is_heard(name: str, level: int = LEVELS["debug"]) -> bool:
    """Whether messages of this level to the logger `shapefit.<name>` are written."""
    logging = sys.modules.get("logging")
    if logging is None:
        return False
    heard: bool = logging.getLogger(f"shapefit.{name}").isEnabledFor(level)
    return heard


def debug(name: str, text: str, *values: object) -> None:
    """Log a text with values in the places of its %s, at the level DEBUG."""
    say(name, LEVELS["debug"], text, *values)


def trace(name: str, text: str, *values: object) -> None:
    """Log a text with values in the places of its %s, at the level TRACE."""
    say(name, TRACE, text, *values)


def say(name: str, level: int, text: str, *values: object) -> None:
    """Log a text with values in the places of its %s, if its level is written."""
    if is_heard(name, level):
        import logging

        logging.getLogger(f"shapefit.{name}").log(level, text, *values)


def follow_environment() -> None:
    """Write messages to standard error at the level that SHAPEFIT_LOG names, if any."""
    level = LEVELS.get(os.environ.get(ENVIRONMENT_KEY, "").lower())
    if level is None:
        return
    import logging

    logger = logging.getLogger("shapefit")
    if not logger.handlers:
        handler = logging.StreamHandler()
        handler.setFormatter(logging.Formatter("%(asctime)s %(name)s: %(message)s"))
        logger.addHandler(handler)
    logger.setLevel(level)
