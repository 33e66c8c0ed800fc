"""The simulation of a fit on many machines: times that are known, and what sets them."""

from dataclasses import replace

import pytest

from benchmarks.scale import Constants, simulate

FREE = Constants(client=0, landmarks=0, result=0, start=0, lifetime=1e9)
"""Machines that wait for nothing and last."""


def test_machines_that_wait_for_nothing_are_always_busy():
    run = simulate(64 * 10_000, 2, 10_000, replace(FREE, cores=16))
    assert run.seconds == pytest.approx(2 * (10_000 / FREE.rate + FREE.part))
    assert run.cores == pytest.approx(1)
    assert run.lost == 0


@pytest.mark.parametrize("busy", ["client", "storage"])
def test_what_all_wait_for_sets_the_time(busy):
    slow = {"client": {"client": 60.0}, "storage": {"result": 1e6, "link": 1e12}}[busy]
    run = simulate(1000 * 10_000, 100, 10_000, replace(FREE, **slow))
    least = {"client": 1000 * 60.0, "storage": 1e7 * 1e6 / FREE.storage}[busy]
    assert least <= run.seconds < 1.01 * least
    assert getattr(run, busy) > 0.99


def test_parts_of_dead_cores_are_done_again():
    run = simulate(500 * 100_000, 1, 100_000, replace(FREE, lifetime=1e-3))
    assert run.lost > 10
    assert run.seconds > simulate(500 * 100_000, 1, 100_000, FREE).seconds
