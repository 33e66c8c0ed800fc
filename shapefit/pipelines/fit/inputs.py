"""The files that a fit reads: none may change while it runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from shapefit.config import FitConfig
from shapefit.io import digests
from shapefit.io.inputs import State, check_unchanged, find_state
from shapefit.pipelines.fit.choices import files_of


@dataclass(eq=False, repr=False)
class WatchedFiles:
    """Landmarks and further files of a fit, as they were found.

    landmark_digests: of the files of landmarks, None until they are computed.
    """

    landmarks: tuple[Path, ...]
    further: tuple[Path, ...]
    states: Mapping[Path, State]
    landmark_digests: Mapping[str, str] | None = None

    @classmethod
    def of_config(
        cls,
        config: FitConfig,
        states: Mapping[Path, State] | None = None,
        landmark_digests: Mapping[str, str] | None = None,
    ) -> WatchedFiles:
        """Return the files of a config, as they are now or were in `states`."""
        further = tuple(files_of(config).values())
        if states is None:
            states = {path: find_state(path) for path in config.landmarks + further}
        return cls(config.landmarks, further, states, landmark_digests)

    def take_digests(self) -> None:
        """Compute the digests of the landmark files, unless they are known."""
        if self.landmark_digests is None:
            self.landmark_digests = digests(self.landmarks)

    def digests(self) -> dict[str, str]:
        """Return name -> digest of all files that are watched."""
        self.take_digests()
        assert self.landmark_digests is not None
        return {**self.landmark_digests, **digests(self.further)}

    def check_unchanged(self) -> None:
        """Raise InputError where a file has changed since its state was taken."""
        check_unchanged(self.states)
