"""`python -m tests.fuzz`: many cases, shared by processes; exit code 1 where one of them fails."""

from __future__ import annotations

import argparse
import os
import sys
from multiprocessing import get_context

from .campaign import Case, Tally, run
from .kinds import KINDS
from .past_findings import FINDINGS

BLOCK = 250
"""Seeds of each kind that a process runs."""


def main() -> int:
    """Run the cases of consecutive seeds, kind by kind, and print what is wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--cases", type=int, default=50_000)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--past", action="store_true", help="what once failed, and nothing else")
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first - (-arguments.cases // len(arguments.kinds)))
    blocks = [
        [Case(kind, seed) for seed in seeds[at : at + BLOCK] for kind in arguments.kinds]
        for at in range(0, len(seeds), BLOCK)
    ]
    if arguments.past:
        blocks = [[Case(name, 0) for name in FINDINGS]]
    # Each in a process of its own: libraries that spoil files keep some of the memory.
    whole = Tally()
    with get_context("spawn").Pool(max(arguments.jobs, 1), maxtasksperchild=1) as pool:
        for tally in pool.imap_unordered(run, blocks):
            whole.codes += tally.codes
            whole.findings += tally.findings
            print(whole, flush=True)
    return 1 if whole.findings else 0


if __name__ == "__main__":
    sys.exit(main())
