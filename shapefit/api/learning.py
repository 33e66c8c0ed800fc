"""`learn` on arrays: the pipeline of `learn-dict`, with the same numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from shapefit.api.arguments import (
    LearnedPrior,
    LearningMethod,
    config_of,
    with_suggestions,
)
from shapefit.api.dictionary import Dictionary
from shapefit.api.messages import warn
from shapefit.api.steps import run_to_end
from shapefit.config.commands.others import LearnDictConfig
from shapefit.errors import counted
from shapefit.io.source import source_of
from shapefit.pipelines.learn_dict.from_3d import learn_from_shapes
from shapefit.records import Fit, Shapes

FILES = {"shapes": (Path("shapes"),), "output": Path("dictionary")}
"""Keys of the command whose place arrays take, and what stands for them in messages."""


@with_suggestions
def learn(
    shapes: Shapes | Fit | ArrayLike,
    k: int | None = None,
    beta: float | None = None,
    *,
    progress: bool = False,
    method: LearningMethod | None = None,
    landmarks: Sequence[str] | None = None,
    rename: Mapping[str, str] | None = None,
    every: int | Mapping[str, int] | None = None,
    align: Literal["all", "none"] | None = None,
    mirror: bool | Mapping[str, str] | None = None,
    prior: LearnedPrior | None = None,
    iterations: int | None = None,
) -> Dictionary:
    """Learn a dictionary from 3D shapes, as the command `learn-dict` does, bit for bit.

    Parameters
    ----------
    shapes : Shapes, Fit, or array of shape (n, p, 3)
        Training shapes, with names, sequences, edges or a mesh where they have some.
    k : int
        Number of atoms of sparse coding.
    beta : float
        Weight of the sparsity of the coefficients.
    progress : bool
        Show a progress bar.
    method : str
        "exemplars": every shape is an atom; "pca-bases": for matching pursuit.
    landmarks : sequence of str
        Landmarks to keep, in this order; by default all.
    rename : mapping of str to str
        Landmarks to rename: given name -> name in the dictionary.
    every : int or mapping of str to int
        Keep every n-th shape of each sequence.
    align : "all" or "none"
        Whether the shapes are turned onto their mean.
    mirror : bool or mapping of str to str
        Add mirror images: of the partners that the shapes state, or of these.
    prior : LearnedPrior
        The prior that error bars need; `{"components": "auto"}` learns one.
    iterations : int
        Rounds of coding all shapes and updating all atoms.

    Returns
    -------
    Dictionary
        What `fit` takes, and `write_dictionary`.

    Raises
    ------
    InputError
        For every wrong argument at once, with what to give instead.

    Warns
    -----
    UserWarning
        For shapes that cannot be used, and what else the command warns of.

    """
    given = {
        "k": k,
        "beta": beta,
        "method": method,
        "landmarks": landmarks,
        "rename": rename,
        "every": every,
        "align": align,
        "mirror": mirror,
        "prior": prior,
        "iterations": iterations,
    }
    config = config_of("learn", LearnDictConfig, given, FILES)
    source = source_of(as_shapes(shapes).named(), "shapes", config.rename)
    warn(source.notes)
    steps = learn_from_shapes(source.whole(), config, {})
    made, results = run_to_end(steps, progress=progress, unit="round")
    from shapefit.lifting.posterior.p_value import with_p_value_table

    dictionary = with_p_value_table(made)
    failures = [failure for result in results for failure in result.failures]
    if failures:
        unused = f"{failures[0].item}, for one: {failures[0].reason}"
        warn([f"{counted(len(failures), 'shape')} cannot be used; {unused}"])
    warn(message for result in results for message in result.warnings)
    return Dictionary.of(dictionary)


def as_shapes(given: Shapes | Fit | ArrayLike) -> Shapes:
    """Return arrays as Shapes, and a fit as Shapes without its other columns."""
    if isinstance(given, Shapes):
        return given
    if not isinstance(given, Fit):
        return Shapes(np.asarray(given))
    return Shapes(
        given.shapes,
        landmark_names=given.landmark_names,
        items=given.items,
        sequences=given.sequences,
        frames=given.frames,
        times=given.times,
        edges=given.edges,
        unit=given.unit,
        frame_rate=given.frame_rate,
    )
