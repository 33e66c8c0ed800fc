"""The time that a fit of 10^9 and 10^10 images takes on many machines, from measured constants.

One client hands out parts and notes what became of them, one after another. A core reads its part
from storage that all cores share, lifts it, writes the result, and comes back for the next. Cores
die at random and lose the part in hand. The table says how busy cores, client and storage are: what
is busy all the time is what a larger cluster would wait for.

    python -m benchmarks.scale             # the table, with the constants below
    python -m benchmarks.scale --measure   # the client's time for a part, on this machine
    python -m benchmarks.scale --storage 50e9 --cores 64
"""

from __future__ import annotations

import argparse
import heapq
import random
import time
from collections import deque
from dataclasses import dataclass, fields
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import cast
from unittest.mock import patch

from benchmarks.parts import PROJECT
from shapefit.io.memory import in_words

HOUR = 3600.0
DAY = 24 * HOUR

MEASURED_PARTS = 2000
"""Parts without work that show what the client needs for one."""


@dataclass(frozen=True)
class Constants:
    """What was measured, then what machines and storage are taken to be; bytes and seconds.

    rate              images/s of a core (`python -m benchmarks.many_images`)
    part              seconds that a part costs by itself (`python -m benchmarks.parts`)
    start             seconds until a core has the program, and can take a part
    client            seconds of client and scheduler for a part (`--measure`)
    landmarks, result bytes of an image (`python -m benchmarks.many_images`)
    entry             bytes of a part in the manifest (the same)
    cores             of a machine
    storage           bytes/s of the shared storage, all reading and writing together
    link              bytes/s that one core gets at most
    lifetime          days until a core dies, on average
    """

    rate: float = 13_600.0
    part: float = 0.05
    start: float = 4.0
    client: float = 0.0052
    landmarks: float = 288.0
    result: float = 1889.0
    entry: float = 359.0
    cores: float = 32.0
    storage: float = 10e9
    link: float = 200e6
    lifetime: float = 100.0


ASKS, HAS_READ, HAS_LIFTED = range(3)


@dataclass
class Server:
    """What serves one after another: until when it is taken, and how long it was."""

    free: float = 0.0
    busy: float = 0.0

    def serve(self, now: float, seconds: float) -> float:
        """Return when a request of this length is done."""
        self.free = max(self.free, now) + seconds
        self.busy += seconds
        return self.free


@dataclass(frozen=True)
class Run:
    """What a simulated run took, and the share of its time that each of its means was at work."""

    seconds: float
    cores: float
    client: float
    storage: float
    lost: int


def simulate(images: int, machines: int, partition: int, known: Constants) -> Run:
    """Go from event to event: a core asks for a part, has read it, has lifted it."""
    chance = random.Random(0)
    parts = -(-images // partition)
    work = partition / known.rate + known.part
    cores = min(machines * int(known.cores), parts)
    events = [(known.start, core, ASKS) for core in range(cores)]
    client, storage = Server(), Server()
    left, lost, end = parts, 0, 0.0
    while events:
        now, core, what = heapq.heappop(events)
        if what == ASKS and left:
            left -= 1
            given = client.serve(now, known.client)
            size = partition * known.landmarks
            read = max(storage.serve(given, size / known.storage), given + size / known.link)
            heapq.heappush(events, (read, core, HAS_READ))
        elif what == HAS_READ:
            alive = chance.expovariate(1 / (known.lifetime * DAY))
            if alive < work:
                left, lost = left + 1, lost + 1
                heapq.heappush(events, (now + alive + known.start, core, ASKS))
            else:
                heapq.heappush(events, (now + work, core, HAS_LIFTED))
        elif what == HAS_LIFTED:
            size = partition * known.result
            end = max(storage.serve(now, size / known.storage), now + size / known.link)
            heapq.heappush(events, (end, core, ASKS))
    busy = parts * work / (end * machines * known.cores)
    return Run(end, busy, client.busy / end, storage.busy / end, lost)


def measure_client() -> float:
    """Return the processor's seconds of client and scheduler for a part without work."""
    from shapefit.config import FitConfig, load_config
    from shapefit.pipelines.outcome import Outcome
    from shapefit.pipelines.parts import cluster
    from shapefit.pipelines.parts.part import Done, Job
    from shapefit.pipelines.parts.plan import Part

    with TemporaryDirectory() as name:
        views = PROJECT / "sample_data/people_views.csv"
        given = {"landmarks": views, "dictionary": "people", "output": f"{name}/", "workers": 2}
        config = cast(FitConfig, load_config("fit", None, (), given))
        parts = [Part(number, (views,), (0, 100), ()) for number in range(MEASURED_PARTS)]

        def no_work(job: Job) -> Done:
            return Done(job.part, Outcome(done=1))

        with patch.object(cluster, "fit_part", no_work), cluster.connected(config) as client:
            began = time.process_time()
            jobs = deque(Job(part, config, Path(name)) for part in parts)
            done = sum(each.outcome.done for each in cluster.on_cluster(client, jobs))
            return (time.process_time() - began) / done


def duration(seconds: float) -> str:
    """Return a time as a person reads it."""
    if seconds < 2 * 60:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 2 * HOUR else f"{seconds / HOUR:.1f} h"


def print_table(known: Constants) -> None:
    """Print a row for each number of images, machines and images of a part."""
    print("| images | machines | partition | parts | time | cores | client | storage | manifest |")
    print("|--:|--:|--:|--:|--:|--:|--:|--:|--:|")
    for images, machines, partition in product((10**9, 10**10), (100, 1000), (100_000, 1_000_000)):
        run = simulate(images, machines, partition, known)
        parts = -(-images // partition)
        shares = " | ".join(f"{share:.0%}" for share in (run.cores, run.client, run.storage))
        manifest = in_words(int(parts * known.entry))
        given = f"10^{len(str(images)) - 1} | {machines:,} | {partition:,} | {parts:,}"
        print(f"| {given} | {duration(run.seconds)} | {shares} | {manifest} |")


def main() -> None:
    """Read the constants, and print the table or what was measured."""
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n")[0])
    parser.add_argument("--measure", action="store_true")
    for constant in fields(Constants):
        parser.add_argument(f"--{constant.name}", type=float, default=constant.default)
    given = vars(parser.parse_args())
    if given.pop("measure"):
        print(f"client and scheduler take {1000 * measure_client():.1f} ms for a part")
        return
    print_table(Constants(**given))


if __name__ == "__main__":
    main()
