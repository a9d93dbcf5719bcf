"""Two ways to train many seeds on one machine: a process a core, or all seeds in one compiled call.

Both make the same updates of the same learner; the figure is updates a second over all seeds together. Rounds of the
two ways take turns. `odaf train` does what this shows to be faster on the processor.
"""

import argparse
import functools
import statistics
import sys
import time
from pathlib import Path
from typing import Any

import jax
import jax.random as jr

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks import learners
from benchmarks.machine import machine, write_figures
from odaf.runs.workers import cores, run_jobs
from odaf.training.loop import (
    donatable,
    split_lanes,
    stacked,
    train_lanes,
    train_stretch,
    training_key,
    update_number,
)  # fmt: skip


def alone(job: tuple[str, int, int, float]) -> float:
    """Updates a second of one seed in this process, once all processes are at it; compilation apart."""
    name, seed, updates, start = job
    algorithm, rows = learners.load(name), learners.columns()
    state = donatable(learners.state_of(algorithm))
    state, _ = train_stretch(algorithm, rows, training_key(seed), update_number(0), update_number(2), state)
    jax.block_until_ready(state)
    while time.time() < start:
        time.sleep(0.01)
    before = time.perf_counter()
    state, _ = train_stretch(algorithm, rows, training_key(seed), update_number(2), update_number(2 + updates), state)
    jax.block_until_ready(state)
    return updates / (time.perf_counter() - before)


def in_processes(name: str, seeds: int, updates: int, wait: float) -> float:
    """Updates a second of all seeds together, each in a process with a share of the cores."""
    jobs = [(name, seed, updates, time.time() + wait) for seed in range(seeds)]
    return sum(speed for _, speed in run_jobs(alone, jobs, workers=seeds))


def in_one_call(name: str, seeds: int, updates: int) -> float:
    """Updates a second of all seeds together, compiled as one."""
    algorithm, rows = learners.load(name), learners.columns()
    states: Any = stacked([donatable(learners.state_of(algorithm)) for _ in range(seeds)])
    keys = jr.split(jr.key(0), seeds)
    structure, numbers = split_lanes([algorithm] * seeds)
    train = functools.partial(train_lanes, structure, numbers, rows, None, keys)
    states, _ = train(update_number(0), update_number(2), states)
    jax.block_until_ready(states)
    before = time.perf_counter()
    states, _ = train(update_number(2), update_number(2 + updates), states)
    jax.block_until_ready(states)
    return seeds * updates / (time.perf_counter() - before)


def main(arguments: list[str] | None = None) -> None:
    """Measure each learner both ways, print the medians, and write them if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--learners", nargs="+", default=["sac-n", "odaf-default"], choices=list(learners.NAMES))
    parser.add_argument("--seeds", type=int, default=cores(), help="seeds, each with its process; default: cores here")
    parser.add_argument("--updates", type=int, default=100, help="updates of a seed in one round")
    parser.add_argument("--rounds", type=int, default=3, help="rounds; the median is reported")
    parser.add_argument("--wait", type=float, default=40.0, help="seconds in which every process must have compiled")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args(arguments)

    about, figures = machine(), {}
    for name in options.learners:
        speeds: dict[str, list[float]] = {"processes": [], "one_call": []}
        for _ in range(options.rounds):
            speeds["processes"].append(in_processes(name, options.seeds, options.updates, options.wait))
            speeds["one_call"].append(in_one_call(name, options.seeds, options.updates))
        found = {way: statistics.median(taken) for way, taken in speeds.items()}
        found["ratio"] = found["processes"] / found["one_call"]
        figures[name] = found
        print(
            f"{name}: {options.seeds} seeds, {found['processes']:.1f} updates/s in processes, "
            f"{found['one_call']:.1f} in one call: {found['ratio']:.2f} times as many",
            flush=True,
        )
    write_figures(options.json, about, {"seeds": options.seeds, "learners": figures})


if __name__ == "__main__":
    main()
