"""The errors of judged images, joined by metric, and the groups of their sequences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from shapefit.errors import abbreviate, input_error
from shapefit.evaluation.metric_table import METRICS
from shapefit.evaluation.summary import ImageErrors, group_sequences
from shapefit.pipelines.evaluate.judgement import Judgement


def image_errors(name: str, judgements: Sequence[Judgement]) -> list[ImageErrors]:
    """Join what the files of one method say about each metric and unit.

    Images that leave a metric undefined are no images of it, unless they failed.
    """
    kinds = dict.fromkeys(kind for judgement in judgements for kind in judgement.errors)
    joined = []
    for kind in kinds:
        images = [
            (item, sequence, value)
            for j in judgements
            if kind in j.errors
            for item, sequence, value in zip(j.items, j.sequences, j.errors[kind], strict=True)
            if not METRICS[kind[0]].of_labels or not np.isnan(value) or item in j.failures
        ]
        if images:
            items, sequences, values = zip(*images, strict=True)
            joined.append(ImageErrors(name, *kind, items, sequences, np.array(values)))
    return joined


def find_grouping(
    groups: Mapping[str, str], errors: Sequence[ImageErrors]
) -> tuple[dict[str, tuple[str, ...]], tuple[str, ...]]:
    """Sequences of each group (name -> glob), and warnings about what matches nothing.

    Raises InputError where no sequence is in any group.
    """
    sequences = dict.fromkeys(s for e in errors for s in e.sequences if s)
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
