"""The table of what is fuzzed: a file format is added by one line here."""

from __future__ import annotations

from collections.abc import Mapping

from . import (
    config_cases,
    csv_cases,
    detector_cases,
    hdf5_cases,
    motion_cases,
    tracker_cases,
)
from .case import Make

KINDS: Mapping[str, Make] = {
    "csv": csv_cases.make,
    "detectors": detector_cases.make,
    "hdf5": hdf5_cases.make,
    "motion": motion_cases.make,
    "trackers": tracker_cases.make,
    "yaml": config_cases.make_yaml,
    "set": config_cases.make_options,
}
"""Kind -> what spoils the files of a folder and returns the command line that reads them."""
