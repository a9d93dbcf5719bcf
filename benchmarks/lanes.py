"""Throughput against the number of lanes: trainings in one compiled program, beside the same trainings in processes.

For each learner and number of lanes: updates a second of all lanes together, seconds to compile, and the memory that
the program takes. On a processor the same trainings are also made in processes, one a core, in rounds that take turns
with the lanes; that is what `odaf train` does there. Peers are timed by `peer_d3rlpy.py` and `updates_per_second.py`.

    python benchmarks/lanes.py --sizes 64 64 --critics 4 --lanes 8 --json benchmarks/last/lanes.json
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
from odaf.runs import presets
from odaf.runs.workers import cores, run_jobs
from odaf.training import loop

Setting = tuple[str, tuple[int, ...], int, int]
"""Preset, hidden sizes, critics, batch size."""


def learner(setting: Setting) -> Any:
    """The learner of a setting; what the preset does not have is left out."""
    preset, sizes, critics, batch = setting
    changes: dict[str, Any] = {"hidden_sizes": sizes, "batch_size": batch}
    if hasattr(presets.load(preset), "num_critics"):
        changes["num_critics"] = critics
    return presets.load(preset, changes)


def compiled(setting: Setting, lanes: int) -> tuple[Any, float]:
    """(the program of so many lanes, seconds that it took to compile)."""
    algorithm, began = learner(setting), time.perf_counter()
    shapes = functools.partial(jax.tree.map, lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype))
    state = shapes(jax.eval_shape(lambda: learners.state_of(algorithm)))
    program = loop.compiled_lanes(algorithm, shapes(learners.columns()), False, state, lanes)
    return program, time.perf_counter() - began


def in_lanes(setting: Setting, program: Any, lanes: int, updates: int) -> float:
    """Updates a second of all lanes together."""
    algorithm, rows = learner(setting), learners.columns()
    _, numbers = loop.split_lanes([algorithm] * lanes)
    states: Any = loop.stacked([loop.donatable(learners.state_of(algorithm)) for _ in range(lanes)])
    keys = jr.split(jr.key(0), lanes)

    def train(first: int, last: int, states: Any) -> Any:
        number = loop.update_number
        return jax.block_until_ready(program(numbers, rows, None, keys, number(first), number(last), states, None))[0]

    states = train(0, 2, states)
    before = time.perf_counter()
    train(2, 2 + updates, states)
    return lanes * updates / (time.perf_counter() - before)


def in_processes(setting: Setting, seeds: int, updates: int, wait: float) -> float:
    """Updates a second of as many trainings, in processes with a core each that take them one after another."""
    workers = min(seeds, cores())
    each = -(-seeds // workers)
    jobs = [(setting, seed, each * updates, time.time() + wait) for seed in range(workers)]
    return sum(speed for _, speed in run_jobs(_alone, jobs, workers=workers))


def _alone(job: tuple[Setting, int, int, float]) -> float:
    setting, seed, updates, start = job
    algorithm, rows, number = learner(setting), learners.columns(), loop.update_number
    state = loop.donatable(learners.state_of(algorithm))
    state, _ = loop.train_stretch(algorithm, rows, loop.training_key(seed), number(0), number(2), state)
    jax.block_until_ready(state)
    while time.time() < start:
        time.sleep(0.01)
    before = time.perf_counter()
    state, _ = loop.train_stretch(algorithm, rows, loop.training_key(seed), number(2), number(2 + updates), state)
    jax.block_until_ready(state)
    return updates / (time.perf_counter() - before)


def main(arguments: list[str] | None = None) -> None:
    """Measure each learner, print one line for each number of lanes, and write the figures if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--learners", nargs="+", default=["sac-n", "odaf"], help="presets")
    parser.add_argument("--sizes", nargs="+", type=int, default=[256, 256, 256], help="units of each hidden layer")
    parser.add_argument("--critics", type=int, default=10)
    parser.add_argument("--batch", type=int, default=256)
    parser.add_argument("--lanes", nargs="+", type=int, default=[1, 4, 16])
    parser.add_argument("--updates", type=int, default=200, help="updates of a lane in one round")
    parser.add_argument("--rounds", type=int, default=3, help="rounds; the median is reported")
    parser.add_argument("--wait", type=float, default=40.0, help="seconds in which every process must have compiled")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args(arguments)

    about, figures = machine(), []
    for preset in options.learners:
        setting = (preset, tuple(options.sizes), options.critics, options.batch)
        for lanes in options.lanes:
            program, seconds = compiled(setting, lanes)
            needs = program.memory_analysis()
            speeds: dict[str, list[float]] = {"lanes": [], "processes": []}
            for _ in range(options.rounds):
                speeds["lanes"].append(in_lanes(setting, program, lanes, options.updates))
                if jax.default_backend() == "cpu":
                    speeds["processes"].append(in_processes(setting, lanes, options.updates, options.wait))
            found = {way: statistics.median(taken) for way, taken in speeds.items() if taken}
            figures.append(
                {
                    "learner": preset,
                    "hidden_sizes": options.sizes,
                    "critics": options.critics,
                    "batch": options.batch,
                    "lanes": lanes,
                    "products": str(jax.config.values["jax_default_matmul_precision"] or "default"),
                    "updates_per_second": found,
                    "rounds": speeds,
                    "compile_seconds": seconds,
                    "program_bytes": needs and needs.temp_size_in_bytes + needs.output_size_in_bytes,
                    "peak_bytes": (jax.devices()[0].memory_stats() or {}).get("peak_bytes_in_use"),
                }
            )
            beside = f", in processes {found['processes']:,.0f}" if "processes" in found else ""
            print(
                f"{preset} {options.critics} x {options.sizes}, {lanes} lanes: {found['lanes']:,.0f} updates/s of all "
                f"lanes together{beside}; compiled in {seconds:.0f} s",
                flush=True,
            )
            write_figures(options.json, about, {"figures": figures})  # so far: the time may end before the last


if __name__ == "__main__":
    main()
