"""The errors of the images of one file by metric, and the groups of their sequences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from shapefit.arrays import Floats
from shapefit.errors import abbreviate, input_error
from shapefit.evaluation.averages import labels_of
from shapefit.evaluation.metric_table import METRICS
from shapefit.evaluation.summary import ImageErrors, group_sequences
from shapefit.pipelines.evaluate.judgement import Judgement
from shapefit.pipelines.evaluate.measurement import Kind


def image_errors(name: str, judgement: Judgement) -> list[ImageErrors]:
    """Return what one file of a method says about each metric and unit."""
    found = []
    failed = judgement.failed()
    for kind, values in judgement.errors.items():
        rows = rows_judged(kind, values, failed)
        items = tuple(judgement.items[row] for row in rows)
        sequences = labels_of([judgement.sequences[row] for row in rows])
        if items:
            found.append(ImageErrors(name, *kind, items, sequences, values[rows]))
    return found


def rows_judged(kind: Kind, values: Floats, failed: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Images (n,) that count in a metric, by their errors (n,) in it.

    Those that leave labels undefined are no images of theirs, unless they failed.
    """
    return np.flatnonzero(failed | ~np.isnan(values) | (not METRICS[kind[0]].of_labels))


def find_grouping(
    groups: Mapping[str, str], errors: Sequence[ImageErrors]
) -> tuple[dict[str, tuple[str, ...]], tuple[str, ...]]:
    """Sequences of each group (name -> glob), and warnings about what matches nothing.

    Raises InputError where no sequence is in any group.
    """
    sequences = dict.fromkeys(s for e in errors for s in e.sequences.names if s)
    grouping = group_sequences(groups, sequences)
    empty = [group for group, members in grouping.items() if not members]
    if len(empty) == len(grouping):
        found = f"no sequence matches any group; the sequences are {abbreviate(list(sequences))}"
        raise input_error("groups", found, "correct the globs, or leave `groups` out")
    grouped = {member for members in grouping.values() for member in members}
    outside = [sequence for sequence in sequences if sequence not in grouped]
    warnings = [f"group {g}: no sequence matches {groups[g]!r}" for g in empty]
    if outside:
        warnings.append(f"sequences in no group, only in per_image.csv: {abbreviate(outside)}")
    return grouping, tuple(warnings)
