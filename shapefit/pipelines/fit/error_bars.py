"""Error bars as wide as those of earlier results had to be to hold the truth."""

from __future__ import annotations

import json

from shapefit.config import FitConfig
from shapefit.errors import input_error


def with_calibration(config: FitConfig) -> tuple[FitConfig, tuple[str, ...]]:
    """Return the config with covariances as much wider as `posterior.calibration` says, and a line.

    By the factors of its method, or of the only one of the report. Raises InputError for a file
    that has none.
    """
    path = config.posterior.calibration
    if path is None:
        return config, ()
    try:
        factors = json.loads(path.read_text(encoding="utf-8"))
        name = config.method if config.method in factors else next(iter(factors))
        half, most = (factors[name][level] for level in ("50%", "90%"))
        known = None in (half, most) or (half > 0 and most > 0)
    except (OSError, ValueError, KeyError, TypeError, StopIteration):
        known = False
    if not known:
        found = "holds no factors of error bars"
        raise input_error(path, found, "give error_bars.json of a report of eval")
    if name != config.method and len(factors) > 1:
        found = f"has factors of {', '.join(factors)}, not of {config.method}"
        raise input_error(path, found, f"judge one result alone, or call it {config.method}")
    if None in (half, most):
        found = "has no factor: too few landmarks, or error bars that are far too narrow"
        raise input_error(path, found, "judge more images, or with a larger `posterior.widening`")
    widening = config.posterior.widening * most**2
    posterior = config.posterior.model_copy(update={"widening": widening, "calibration": None})
    line = (
        f"error bars {most:.2f} times as wide, by {path.name}: 90% of that truth is in the 90% "
        f"ellipsoids, 50% in {half / most:.2f} times the 50% ellipsoids"
    )
    return config.model_copy(update={"posterior": posterior}), (line,)
