"""`simulate`: planted instances of the noiseless program, cell by cell, and how many come back."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from shapefit import __version__
from shapefit.config import SimulateConfig
from shapefit.errors import counted
from shapefit.evaluation import recovery
from shapefit.evaluation.experiment_plots import heat_maps
from shapefit.evaluation.plots import writers as drawings
from shapefit.evaluation.recovery import Attempt, Cell, RecoveryGrid, plant, recover
from shapefit.io.memory import check_fits
from shapefit.io.whole.folder import Write, check_folder, write_folder
from shapefit.pipelines.drawing import draws_plots, plots_left_out
from shapefit.pipelines.outcome import Failure, Outcome

COPIES = 8
"""Of the atoms of an instance, that the solver holds at a time: a generous guess."""

SUCCESS_BELOW = 1e-3
"""Relative error of the transforms below which they are recovered exactly."""

PROGRAMS = {
    "free": "min sum ||M_i||_2 subject to W = sum M_i B_i + T 1^T (the paper's program on centred "
    "data), with {k} atoms.",
    "none": "min sum ||M_i||_2 subject to W = sum M_i B_i, without a translation, with {k} atoms.",
}


def run(config: SimulateConfig) -> Iterator[Outcome]:
    """Attempt all trials of each cell, then write the tables and the heat map to the folder.

    One outcome per cell, with the trials that could not be solved, and a last one with the Markdown
    table as its note. Raises InputError for a folder that cannot be written, and plots that are
    asked for without matplotlib.
    """
    check_folder(config.output)
    draws = draws_plots(config.plots)
    _check_memory(config)
    began = time.perf_counter()
    places = [(p, z) for p in config.landmarks for z in config.active_atoms]
    cells: list[Cell] = []
    # Every trial has atoms of its own and so is a problem of its own; the kernels release the GIL.
    with ThreadPoolExecutor(config.threads or os.cpu_count()) as pool:
        for p, z in places:
            attempts = tuple(pool.map(partial(attempt, config, p, z), range(config.trials)))
            cell = Cell(p, z, attempts, SUCCESS_BELOW)
            cells.append(cell)
            yield Outcome(
                done=config.trials,
                total=config.trials * len(places),
                failures=tuple(_failure(cell, trial) for trial in cell.unsolved),
                note=f"p={p} z={z}: {cell.success:.2f}",
            )
    grid = RecoveryGrid(
        cells=tuple(cells),
        program=PROGRAMS[config.translation].format(k=config.k),
        provenance={
            "version": __version__,
            "config": json.loads(config.as_json()),
            "seconds": time.perf_counter() - began,
        },
    )
    written = write_folder(config.output, _writers(grid, with_plot=draws))
    yield Outcome(
        note=recovery.markdown(grid).rstrip(),
        warnings=plots_left_out(config.plots),
        written=written,
    )


def _check_memory(config: SimulateConfig) -> None:
    """Raise InputError for numbers of atoms and landmarks that do not fit in memory."""
    threads = config.threads or os.cpu_count() or 1
    size = COPIES * threads * 8 * 3 * config.k * max(config.landmarks)
    check_fits("landmarks", size, f"k = {config.k} with {max(config.landmarks)} landmarks")


def attempt(config: SimulateConfig, p: int, z: int, trial: int) -> Attempt:
    """Plant and recover one instance.

    Its random numbers belong to the seed, the cell and the trial: they depend neither on the other
    cells nor on the number of threads.
    """
    stream = np.random.SeedSequence(config.seed, spawn_key=(p, z, trial))
    return recover(
        plant(config.k, p, z, np.random.default_rng(stream)),
        free_translation=config.translation == "free",
        tolerance=config.solver.tolerance,
        max_iterations=config.solver.max_iterations,
    )


def _failure(cell: Cell, trial: int) -> Failure:
    found = cell.attempts[trial]
    gap = "" if np.isnan(found.relative_gap) else f"relative gap {found.relative_gap:.2g}, "
    return Failure(
        f"p={cell.p} z={cell.z} trial {trial}",
        f"{found.status.value} after {counted(found.iterations, 'iteration')}, {gap}"
        f"residual {found.residual:.2g}; counted as not recovered",
    )


def _writers(grid: RecoveryGrid, *, with_plot: bool) -> dict[str, Write]:
    writers: dict[str, Write] = {
        "recovery.csv": lambda path: recovery.write_csv(path, grid),
        "recovery.json": lambda path: path.write_text(recovery.grid_json(grid), "utf-8"),
        "recovery.md": lambda path: path.write_text(recovery.markdown(grid), "utf-8"),
    }
    if with_plot:
        figure = heat_maps(
            {"Share recovered exactly": grid.shares}, "landmarks p", "atoms in use z"
        )
        writers |= drawings("recovery", figure)
    return writers
