"""People, cars and a dog: shapes, images, dictionaries and fits, each made once in a
run.

`world.dictionary("people")` and `world.fit("people", method="posterior")` are paths of
files, made when they are first asked for and by whichever process of the run asks
first. Nobody writes to them: a test that changes a file copies it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from shapefit.config import CONFIGS
from shapefit.pipelines.fit.fit import fit as run_fit
from shapefit.pipelines.learn_dict import run as learn_dict
from shapefit.pipelines.projection import project_shapes as run_project

SAMPLES = Path(__file__).resolve().parents[1] / "sample_data"
INSTALLED = SAMPLES.parent / "shapefit/data/people.h5"

SHAPES = {"people": "people_train.h5", "cars": "cars.h5", "dog": "animal_train.h5"}
TRUTH = {"people": "people_test.h5", "cars": "cars.h5", "dog": "animal_truth.h5"}
IMAGES = {
    "people": "people_views.csv",
    "cars": "cars_views.h5",
    "dog": "animal_walk.csv",
    "walk": "openpose",
}
"""Kind -> its file in sample_data; `walk` are two people as OpenPose finds them."""

LEARNED: dict[str, dict[str, Any]] = {
    "people": {"k": 12, "iterations": 2, "every": 8},
    "other people": {"k": 12, "iterations": 1, "every": 9},
    "people with a prior": {
        "k": 12, "iterations": 2, "every": 8, "prior": {"components": 2, "floor": 0.01},
    },
    "bases of people": {"method": "pca-bases", "every": 20},
    "exemplars of people": {"method": "exemplars", "every": 60},
    "cars": {"method": "exemplars", "align": "none"},
    "dog": {"k": 8, "iterations": 2, "every": 4},
}  # fmt: skip
"""Dictionary -> the keys that it is learned with, from the shapes that its last word
names.
"""

Once = Callable[[str, Callable[[Path], object]], Path]


@dataclass(frozen=True)
class World:
    """Files by what they hold; `once` makes one in a folder that all processes of a run
    share.
    """

    once: Once
    _known: dict[str, Path] = field(default_factory=dict)

    def shapes(self, kind: str) -> Path:
        """Return the training shapes of people, cars or the dog."""
        return SAMPLES / SHAPES[kind]

    def truth(self, kind: str) -> Path:
        """Return true shapes that images of the kind show."""
        return SAMPLES / TRUTH[kind]

    def images(self, kind: str) -> Path:
        """Return images of people, cars, the dog, or the walk of two people."""
        return SAMPLES / IMAGES[kind]

    def dictionary(self, name: str) -> Path:
        """Return a dictionary: one of LEARNED, or the installed one (`prior`, and for
        `walk`).
        """
        if name in ("prior", "walk"):
            return INSTALLED
        arguments = {
            "shapes": [str(self.shapes(name.split()[-1].replace("prior", "people")))]
        }
        return self._make(
            name, learn_dict.learn_dictionary, "learn-dict", arguments | LEARNED[name]
        )

    def views(self, kind: str, **keys: Any) -> Path:
        """Return the true shapes of a kind as `project` sees them, with its keys."""
        arguments = {"shapes": [str(self.truth(kind))], **keys}
        return self._make(f"views of {kind}", run_project, "project", arguments)

    def fit(
        self,
        kind: str,
        dictionary: str = "",
        *,
        images: Path | None = None,
        **keys: Any,
    ) -> Path:
        """Return the result of images of a kind with keys of `fit`, by the dictionary
        so named.
        """
        if kind == "walk":
            keys = {"keypoints": "body_25", **keys}
        given = images or self.images("people" if kind == "prior" else kind)
        paths = {
            "landmarks": [str(given)],
            "dictionary": str(self.dictionary(dictionary or kind)),
        }
        return self._make(
            f"fit of {kind}", run_fit, "fit", {"method": "convex"} | paths | keys
        )

    def _make(
        self,
        what: str,
        run: Callable[[Any], Any],
        command: str,
        arguments: dict[str, Any],
    ) -> Path:
        digest = hashlib.sha256(
            json.dumps(arguments, sort_keys=True).encode()
        ).hexdigest()[:12]
        name = f"{what.replace(' ', '-')}-{digest}.h5"
        if name not in self._known:

            def make(path: Path) -> None:
                config = CONFIGS[command](output=str(path), **arguments)
                for _ in run(config):
                    pass

            self._known[name] = self.once(name, make)
        return self._known[name]
