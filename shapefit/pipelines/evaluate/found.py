"""What is known of results: judged file by file, one of which is in memory at a time."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from shapefit.errors import listed
from shapefit.evaluation.calibration import Coverages, image_shares
from shapefit.evaluation.metric_table import PLAUSIBILITY
from shapefit.evaluation.summary import ImageErrors
from shapefit.io import ResultSet, digest, read_results
from shapefit.pipelines.evaluate.error_bars import judge_error_bars
from shapefit.pipelines.evaluate.examples import chosen_items, examples_picture, read_lifted
from shapefit.pipelines.evaluate.floors import Floors
from shapefit.pipelines.evaluate.judgement import judge
from shapefit.pipelines.evaluate.measurement import as_named, find_dataset, visible_enough
from shapefit.pipelines.evaluate.method_images import MethodImages
from shapefit.pipelines.evaluate.plan import MeasuringOptions, Truth
from shapefit.pipelines.evaluate.report_pages import contact_sheet
from shapefit.pipelines.outcome import Failure, Outcome

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Found:
    """What is known once all results were judged.

    errors and methods in the order of `results`, shares those of the landmarks of each image inside
    the error bars, where a method has these; the warnings, each once; sheets the contact sheets of
    the fits.
    """

    def __init__(self, options: MeasuringOptions, truth: Truth) -> None:
        self.truth = truth
        self.methods: list[MethodImages] = []
        self.errors: list[ImageErrors] = []
        self.shares: list[ImageErrors] = []
        self.warnings = dict.fromkeys(truth.lacks)
        self.sheets: dict[str, dict[Path, None]] = {}
        self.bars: dict[str, Coverages] = {}
        self.floors = Floors(options.floors, truth.head, options.folder) if options.floors else None
        self._options = options
        self._truth_digests = {digest(path): path for path in options.truth}
        self._held: dict[Path, ResultSet] = {}

    def judge_all(self, *, hold: bool) -> Iterator[Outcome]:
        """Judge every result file; one outcome per file.

        With `hold` results that cannot be read again stay in memory, to draw examples of them.
        """
        for name, files in self._options.results.items():
            images = MethodImages(name, self._options.folder)
            if self.floors:
                self.floors.begin_method()
            for file in files:
                yield self._judge(images, file, hold=hold and not file.is_file())
            images.check_distinct()
            self.methods.append(images)
            self.errors += images.errors()
            self.shares += images.shares()

    def draw_examples(self, wanted: int | Sequence[str]) -> Figure:
        """Draw the images that are wanted, of those that no method failed on."""
        chosen = chosen_items(wanted, self.methods, self._options.folder)
        lifted, true = read_lifted(self._options, chosen, self.methods, self.truth, self._held)
        return examples_picture(chosen, lifted, true)

    def _judge(self, images: MethodImages, file: Path, *, hold: bool) -> Outcome:
        """Judge one file, which is in memory no longer than that, unless it is to be held."""
        options, name = self._options, images.name
        results = as_named(read_results(file), self.truth.head.landmark_names)
        if hold:
            self._held[file] = results
        sheet = contact_sheet(str(results.attributes.get("config", "")))
        if sheet is not None:
            self.sheets.setdefault(name, {})[sheet] = None
        shown, too_few = visible_enough(file, results, options.least_visible)
        judgement = judge(
            file,
            shown,
            self.truth.named,
            options.match,
            options.metrics,
            frame=options.truth_frame,
        )
        unjudged: tuple[str, ...] = ()
        plausibility, shares = None, None
        if options.calibration:
            bars, unjudged = judge_error_bars(shown, judgement)
            plausibility = find_dataset(file, shown, PLAUSIBILITY)
            if bars is not None:
                shares = image_shares(bars)
                self.bars.setdefault(name, Coverages(options.groups)).add(bars)
        images.add(judgement, results, plausibility, shares)
        if self.floors:
            self.floors.add(shown, judgement, judgement.truth)
        trained = find_training_truth(name, results.attributes, self._truth_digests)
        new = [
            w
            for w in (*trained, *too_few, *judgement.warnings, *unjudged)
            if w not in self.warnings
        ]
        self.warnings |= dict.fromkeys(new)
        return Outcome(
            done=len(judgement.items),
            failures=tuple(Failure(i, f"{name}: {w}") for i, w in judgement.failures.items()),
            warnings=tuple(new),
            note=name,
        )


def find_training_truth(
    method: str, attributes: Mapping[str, object], truth: Mapping[str, Path]
) -> list[str]:
    """Warn where the truth, files by their digests, is what a method's dictionary learned from.

    A fit with `leave_out` ignores, in each image, the atoms of the shape that it shows.
    """
    if stated_of(attributes, "config").get("leave_out"):
        return []
    training = stated_of(attributes, "training_inputs").values()
    same = [str(path) for digest, path in truth.items() if digest in training]
    if not same:
        return []
    return [
        f"{method}: the dictionary was learned from the truth, {listed(same, 'and')}, so these are "
        "errors on shapes that it has seen: give shapes that took no part in learning"
    ]


def stated_of(attributes: Mapping[str, object], name: str) -> Mapping[str, Any]:
    """Return the JSON object that an attribute of a result holds; an empty one without."""
    try:
        found = json.loads(str(attributes.get(name, "{}")))
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}
