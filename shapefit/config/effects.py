"""When a key has an effect: one table for all commands, by which a key without effect is an error.

A key that is not in the table always counts. What the files decide (their format, whether they
hold confidences, ...) is checked where they are opened, `io`'s table of the same kind.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from shapefit.config.paths import ResultFolder
from shapefit.errors import listed
from shapefit.lifting.methods import ALTERNATION, METHODS, POSTERIOR, SEARCH, those

HOLDS_DATASETS = ("", ".h5", ".hdf5", ".hdf", ".he5")
"""Endings of outputs that hold more than points."""


class Effect(NamedTuple):
    """Where keys count.

    keys       names of keys, `a.b` in a section; of a section all of its keys
    counts     whether they have an effect in this config
    because    the keys that decide it: where one of them is set above the others, as `--set` is
               above a file, what they leave without effect is no mistake
    condition  in words: "`key` counts only CONDITION"
    """

    keys: tuple[str, ...]
    counts: Callable[[Any], object]
    because: tuple[str, ...]
    condition: str


def _with_methods(keys: str, names: tuple[str, ...]) -> Effect:
    """Return the row of keys that these methods of `fit` read."""
    condition = f"with {listed(f'`method: {name}`' for name in names)}"
    return Effect(tuple(keys.split()), lambda fit: fit.method in names, ("method",), condition)


def _of_section(section: object) -> tuple[str, ...]:
    return those(lambda method: method.section == section)


def _holds_datasets(fit: Any) -> bool:
    if fit.output is None or isinstance(fit.output, ResultFolder):
        return True
    return fit.output.suffix.lower() in HOLDS_DATASETS


OF_PRIOR = those(lambda method: method.has_prior)
NAMED_PRIOR = listed(f"`method: {name}`" for name in OF_PRIOR)
SIGNED = tuple(name for name in _of_section(ALTERNATION) if METHODS[name].mixes_atoms)
CODING = ("k", "beta", "iterations")
SOLVED = those(lambda method: method.proves != "nothing")

EFFECTS: dict[str, tuple[Effect, ...]] = {
    "fit": (
        _with_methods("alternation.views", _of_section(ALTERNATION)),
        _with_methods("alternation.signed", SIGNED),
        _with_methods("search", _of_section(SEARCH)),
        _with_methods("posterior", _of_section(POSTERIOR)),
        _with_methods("theta", OF_PRIOR),
        _with_methods("sequences.lengths", those(lambda method: method.sequences)),
        _with_methods("solver proof", SOLVED),
        Effect(
            ("lambda",),
            lambda fit: fit.loss != "exact" and fit.method != "pmp",
            ("loss", "method"),
            "where residuals have a weight: not with `loss: exact`, nor with `method: pmp`",
        ),
        Effect(
            ("noise",),
            lambda fit: fit.lam == "auto" or METHODS[fit.method].precisions,
            ("lambda", "method"),
            f"with `lambda: auto`, and with {NAMED_PRIOR}",
        ),
        Effect(
            ("outliers.threshold",),
            lambda fit: fit.outliers.method != "none",
            ("outliers", "outliers.method"),
            "with a method of `outliers`",
        ),
        Effect(
            ("partition",),
            lambda fit: isinstance(fit.output, ResultFolder),
            ("output",),
            "with a folder as `output`, a name that ends in /",
        ),
        Effect(
            ("proof", "posterior.covariance"),
            _holds_datasets,
            ("output",),
            "for an `output` in HDF5",
        ),
    ),
    "learn-dict": (
        Effect(
            CODING,
            lambda learning: learning.method == "sparse-coding",
            ("method",),
            "with `method: sparse-coding`",
        ),
        Effect(
            ("bases",),
            lambda learning: learning.method == "pca-bases",
            ("method",),
            "with `method: pca-bases`",
        ),
        Effect(
            ("mirror",),
            lambda learning: learning.symmetry != "none",
            ("symmetry",),
            "with `symmetry`",
        ),
    ),
    "project": (
        Effect(
            ("camera.up",),
            lambda project: project.camera.view == "turntable",
            ("camera", "camera.view"),
            "with `view: turntable`",
        ),
        Effect(
            ("seed",),
            lambda project: project.noise or project.hidden or project.camera.view == "random",
            ("noise", "hidden", "camera", "camera.view"),
            "with `noise`, `hidden` or `camera: {view: random}`",
        ),
    ),
    "view": (
        Effect(("match", "input.rename"), lambda view: view.truth, ("truth",), "with `truth`"),
    ),
}


def idle_keys(command: str, config: Any) -> Iterator[tuple[tuple[str, ...], Effect]]:
    """Yield the keys (as the way to them) that have no effect in a config, each with its row."""
    for effect in EFFECTS.get(command, ()):
        if not effect.counts(config):
            for key in effect.keys:
                yield tuple(key.split(".")), effect
