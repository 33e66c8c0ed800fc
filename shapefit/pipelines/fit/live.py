"""`fit --live`: the shape of each item as soon as its landmarks have come."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain

from shapefit.config import FitConfig
from shapefit.config.paths import STANDARD_STREAM
from shapefit.dictionary.model import Dictionary
from shapefit.errors import input_error
from shapefit.io import read_dictionary
from shapefit.io.live import LiveLandmarks
from shapefit.lifting.methods import METHODS
from shapefit.pipelines.fit.calibration import calibrate
from shapefit.pipelines.fit.choices import (
    choose_method,
    match_to_dictionary,
    reading_options,
)
from shapefit.pipelines.fit.family import Batch
from shapefit.pipelines.fit.fit import lift_batch, open_writer, plan_fit
from shapefit.pipelines.fit.summary import InputsRead, Tally, summarise_fit
from shapefit.pipelines.result import Result

PLACE = "--live"


def fit_live(config: FitConfig) -> Iterator[Result]:
    """Lift each item of standard input when it is complete, and write its rows.

    Yields a Result per item, and a last one that sums up. Raises InputError for what
    needs more than one item, and as `fit`; what was written before then stays.
    """
    check_streams(config)
    dictionary = read_dictionary(config.dictionary)
    config, chosen = choose_method(config, dictionary, lambda: False)
    check_method(config, dictionary)
    landmarks = LiveLandmarks(reading_options(config), dictionary.landmark_names)
    items = landmarks.items()
    first = next(items)
    match = match_to_dictionary(config, dictionary, first.landmark_names)
    calibration = yield from calibrate(config, match, first, len(first))
    plan = plan_fit(config, match, calibration)

    tally = Tally()
    with open_writer(plan) as writer:
        for item in chain([first], items):
            batch = lift_batch(Batch(item), plan)
            writer.append(batch.record)
            tally.add(batch.record)
            yield batch.event
    read = InputsRead(first.take(slice(0, 0)), landmarks.count, notes=landmarks.notes)
    yield summarise_fit(read, plan, tally, chosen, writer.summary)


def check_streams(config: FitConfig) -> None:
    """Raise InputError for inputs, outputs and keys that need all items at once."""
    if config.landmarks != (STANDARD_STREAM,):
        fault = "reads standard input alone"
        raise input_error(PLACE, fault, "give - as LANDMARKS, or leave out --live")
    if config.output != STANDARD_STREAM:
        fault = "writes CSV to standard output alone"
        raise input_error(PLACE, fault, "give -o -, or leave out --live")
    if config.format not in ("auto", "csv"):
        fault = f"reads CSV, and the format is {config.format}"
        raise input_error(PLACE, fault, "convert the file, or leave out --live")
    needs = {
        "frames": config.frames is not None,
        "every": config.every != 1,
        "individual": config.individual is not None,
        "leave_one_out": config.leave_one_out is not None,
        "export.folder": config.export.folder is not None,
    }
    for key, is_given in needs.items():
        if is_given:
            fix = f"leave out `{key}`, or --live"
            raise input_error(PLACE, f"`{key}` is for files", fix)


def check_method(config: FitConfig, dictionary: Dictionary) -> None:
    """Raise InputError for a method that needs sequences or a sample of the images."""
    method = METHODS[config.method]
    if not method.needs_prior:
        return
    what = "its scales and error bars follow from a sample of the images"
    if method.takes_sequences:
        what = "it needs whole sequences"
    fix = "give --method convex, or leave out --live"
    raise input_error(PLACE, f"the method {config.method} cannot be live: {what}", fix)
