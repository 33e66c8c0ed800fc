"""Which images of a result file show enough of their object to be judged."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from shapefit.errors import input_error
from shapefit.evaluation.metric_table import LANDMARKS
from shapefit.evaluation.metrics import visible_in_both
from shapefit.io.records import ResultSet
from shapefit.pipelines.evaluate.result_datasets import find_dataset

KEY = "least_visible"


def visible_enough(file: Path, results: ResultSet, least: int) -> tuple[ResultSet, tuple[str, ...]]:
    """Return the images with at least so many observed landmarks, and a warning about the others.

    Raises InputError where the file has no observed landmarks, or no such image.
    """
    if not least:
        return results, ()
    observed = find_dataset(file, results, LANDMARKS)
    if observed is None:
        fix = f"fit to a file that ends in .h5, or leave out `{KEY}`"
        raise input_error(file, f"has no dataset 'landmarks', which `{KEY}` counts in", fix)
    count = visible_in_both(observed, observed).sum(axis=-1)
    enough = count >= least
    if not enough.any():
        found = f"none of its {len(results)} images has {least} observed landmarks"
        fix = f"set `{KEY}` to {max(count, default=0)} or less"
        raise input_error(file, found, fix)
    if enough.all():
        return results, ()
    # Without the name of the file: results of the same images have one warning together.
    warning = (
        f"{(~enough).sum()} of {len(results)} images left out: fewer than {least} observed "
        "landmarks"
    )
    return results.take(np.flatnonzero(enough)), (warning,)
