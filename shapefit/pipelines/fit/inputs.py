"""The files that a fit reads: none may change while it runs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from shapefit.config import FitConfig
from shapefit.errors import path_text
from shapefit.io import digests
from shapefit.io.inputs import State, check_unchanged, find_state
from shapefit.pipelines.fit.choices import files_of


@dataclass(eq=False, repr=False)
class WatchedFiles:
    """Landmarks and further files of a fit, as they were found.

    known: digests that were computed so far, by the names of the files.
    """

    landmarks: tuple[Path, ...]
    further: tuple[Path, ...]
    states: Mapping[Path, State]
    known: dict[str, str]

    @classmethod
    def of_config(
        cls,
        config: FitConfig,
        states: Mapping[Path, State] | None = None,
        known: Mapping[str, str] | None = None,
    ) -> WatchedFiles:
        """Return the files of a config, as they are now or were in `states`.

        known: their digests, as far as they are known.
        """
        further = tuple(files_of(config).values())
        if states is None:
            states = {path: find_state(path) for path in config.landmarks + further}
        return cls(config.landmarks, further, states, dict(known or {}))

    def take_digests(self) -> None:
        """Compute the digests of the landmark files, unless they are known."""
        self._digest(self.landmarks)

    def digests(self) -> dict[str, str]:
        """Return name -> digest of all files that are watched."""
        self._digest(self.landmarks + self.further)
        files = dict.fromkeys(map(path_text, self.landmarks + self.further))
        return {name: self.known[name] for name in files}

    def _digest(self, paths: tuple[Path, ...]) -> None:
        """Compute the digests of those files of which none is known."""
        self.known |= digests(
            path for path in paths if path_text(path) not in self.known
        )

    def check_unchanged(self) -> None:
        """Raise InputError where a file has changed since its state was taken."""
        check_unchanged(self.states)
