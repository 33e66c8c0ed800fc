"""3D shapes to a dictionary, as the command `learn-dict`."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

from numpy.typing import ArrayLike

from shapefit.config import LearnDictConfig
from shapefit.errors import counted
from shapefit.face.options import config_of, default
from shapefit.face.records import Dictionary, Shapes, rows_of, shape_set
from shapefit.io.layout import DICTIONARY
from shapefit.io.source import source_of
from shapefit.pipelines.learn_dict.from_3d import learn_from_shapes
from shapefit.pipelines.outcome import Failure, Note, Outcome

FILES = {"shapes": (Path("shapes"),), "output": Path("dictionary")}
"""What stands for the files of the command in messages."""


def learn(
    shapes: Shapes | ArrayLike,
    k: int = default(LearnDictConfig, "k"),
    beta: float = default(LearnDictConfig, "beta"),
    **options: Any,
) -> Dictionary:
    """Learn a dictionary from 3D shapes; equal bit for bit to what `learn-dict` writes.

    shapes (n, p, 3), or Shapes with names, sequences, edges or a mesh; k, beta and options are
    keys of the command, such as `method="exemplars"` (docs/config.md). Shapes that cannot be used,
    and what else the command warns of, are Python warnings. Raises InputError.
    """
    own = {"k": k, "beta": beta}
    # Those of another method do not know these keys: their defaults count as not given.
    given = {key: value for key, value in own.items() if value != default(LearnDictConfig, key)}
    config = config_of(LearnDictConfig, "learn", given, options, FILES)
    given_set = source_of(shape_set(shapes), "shapes", config.input.rename).whole()
    making = learn_from_shapes(given_set, config, {})
    failures: list[Failure] = []
    messages: list[str] = []
    while True:
        try:
            outcome: Outcome = next(making)
        except StopIteration as stop:
            dictionary = stop.value
            break
        failures += outcome.failures
        messages += [str(each) for each in outcome.warnings if not isinstance(each, Note)]
    if failures:
        unused = f"{failures[0].item}, for one: {failures[0].reason}"
        messages.insert(0, f"{counted(len(failures), 'shape')} cannot be used; {unused}")
    for message in messages:
        warnings.warn(message, stacklevel=2)
    return rows_of(dictionary, Dictionary, DICTIONARY)
