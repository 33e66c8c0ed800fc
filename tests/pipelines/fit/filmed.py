"""Sequences of the sample data, lifted by a small dictionary of people."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shapefit.config import LearnDictConfig, ProjectConfig
from shapefit.pipelines.learn_dict.run import learn_dictionary
from shapefit.pipelines.projection import project_shapes
from shapefit.records import Fit, Landmarks
from tests.io.files import load, save
from tests.pipelines.fitted import fit_file, texts


@dataclass(frozen=True)
class Filmed:
    """A folder with a dictionary that has a prior, with the views of all test shapes,
    and with those of some sequences of them.
    """

    folder: Path

    @property
    def dictionary(self) -> Path:
        return self.folder / "dictionary.h5"

    @property
    def all_views(self) -> Path:
        return self.folder / "all.h5"

    @property
    def views(self) -> Path:
        return self.folder / "views.h5"


def film_people(samples: Path, folder: Path) -> Filmed:
    """Learn the dictionary, and project the test shapes."""
    filmed = Filmed(folder)
    learn = LearnDictConfig(
        shapes=(samples / "people_train.h5",),
        output=filmed.dictionary,
        k=16,
        iterations=3,
        prior={"components": 4, "floor": 0.01},
    )
    project = ProjectConfig(
        shapes=(samples / "people_test.h5",), output=filmed.all_views
    )
    list(learn_dictionary(learn))
    list(project_shapes(project))
    some_sequences = load(filmed.all_views).take(slice(0, 320))
    save(filmed.views, some_sequences)
    return filmed


def fit_sequences(
    folder: Path, landmarks: Path | Landmarks, dictionary: Path, **keys: Any
) -> tuple[Fit, list[str]]:
    """Fit landmarks in a folder by `sequences`, or as the keys say; return the result
    and the warnings.
    """
    keys = {"method": "sequences", **keys}
    if isinstance(landmarks, Landmarks):
        path = folder / "clip.h5"
        save(path, landmarks)
        landmarks = path
    result, outcomes = fit_file(landmarks, dictionary, folder / "result.h5", **keys)
    return result, texts(outcomes)
