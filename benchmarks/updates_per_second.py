"""How many updates a second each learner makes, beside what the machine's matrix products allow.

The ceiling is the batched product (10, 256, 256) x (10, 256, 256) of the compiler that trains, measured in the same
rounds as the learners, so that a slow or busy machine slows both. Operations are counted by hand: operations.py holds
the table. docs/results/speed.md says how to read the figures and where the time goes.
"""

import argparse
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import jax.random as jr

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks import learners, parts
from benchmarks.machine import machine, write_figures
from benchmarks.operations import flop_per_update

PRODUCTS = 50  # in one call of the ceiling
FLOP_OF_CEILING = 2.0 * PRODUCTS * 10 * 256**3
PEER = Path(__file__).with_name("peer_d3rlpy.py")


def ceiling() -> Callable[[], object]:
    """A call that makes `PRODUCTS` batched products and waits for them."""
    weights = jr.normal(jr.key(0), (10, 256, 256)) / 16.0

    @jax.jit
    def products(x: jax.Array) -> jax.Array:
        return jax.lax.fori_loop(0, PRODUCTS, lambda _, x: jnp.einsum("kbi,kio->kbo", x, weights), x)

    return lambda: jax.block_until_ready(products(weights))


def seconds_of(call: Callable[[], object]) -> float:
    """Wall seconds of one call."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def measure(names: list[str], rounds: int, seconds: float) -> dict:
    """Compile all, then go through them in turn; medians over the rounds."""
    rows = learners.columns()
    product, calls, counts, compiled = ceiling(), {}, {}, {}
    product()
    for name in names:
        calls[name] = learners.updates(learners.load(name), rows)
        compiled[name] = seconds_of(lambda name=name: calls[name](1))
        counts[name] = max(1, round(seconds / seconds_of(lambda name=name: calls[name](2)) * 2))
        print(f"{name:20} compiled in {compiled[name]:5.1f} s, {counts[name]} updates a round", flush=True)
    times: dict[str, list[float]] = {name: [] for name in names}
    ceilings = []
    for _ in range(rounds):
        for name in names:
            ceilings.append(seconds_of(product))
            times[name].append(seconds_of(lambda name=name: calls[name](counts[name])))
    peak = FLOP_OF_CEILING / statistics.median(ceilings) / 1e9
    print(f"\nceiling (batched products 10x256x256x256): {peak:.0f} GFLOP/s\n")
    print(f"{'':20} {'updates/s':>10} {'slowest':>9} {'fastest':>9} {'GFLOP':>7} {'share':>6}")
    figures = {}
    for name in names:
        speeds = sorted(counts[name] / taken for taken in times[name])
        speed = statistics.median(speeds)
        work = flop_per_update(learners.load(name), learners.SPEC)
        figures[name] = {
            "updates_per_second": speed,
            "slowest_round": speeds[0],
            "fastest_round": speeds[-1],
            "gflop_per_update": None if work is None else work / 1e9,
            "ceiling_share": None if work is None else speed * work / 1e9 / peak,
            "seconds_to_compile": compiled[name],
        }
        counted = "" if work is None else f"{work / 1e9:7.2f} {speed * work / 1e9 / peak:6.0%}"
        print(f"{name:20} {speed:10.1f} {speeds[0]:9.1f} {speeds[-1]:9.1f} {counted}")
    return {"ceiling_gflops": peak, "learners": figures}


def main(arguments: list[str] | None = None) -> None:
    """Measure in interleaved rounds, print the medians, and write them if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--learners", nargs="+", default=list(learners.NAMES), choices=list(learners.NAMES))
    parser.add_argument("--rounds", type=int, default=7, help="rounds; the median is reported")
    parser.add_argument("--seconds", type=float, default=2.0, help="about how long a learner runs in one round")
    parser.add_argument("--quick", action="store_true", help="3 rounds of 1 second: done within ten minutes")
    parser.add_argument("--parts", metavar="LEARNER", help="show where the time of one learner's update goes instead")
    parser.add_argument("--peer-python", type=Path, help="interpreter that has d3rlpy: time it too (peer_d3rlpy.py)")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args(arguments)
    rounds, seconds = (3, 1.0) if options.quick else (options.rounds, options.seconds)

    about = machine()
    if options.parts:
        content = {"parts": parts.show(options.parts, rounds, seconds)}
    else:
        content = measure(options.learners, rounds, seconds)
        if options.peer_python:
            done = subprocess.run([options.peer_python, PEER], check=True, capture_output=True, text=True)
            content["peers"] = json.loads(done.stdout.splitlines()[-1])  # its log stands before
            for name, peer in content["peers"].items():
                print(f"{name:20} {peer['updates_per_second']:10.1f}   {peer['what']}")
    write_figures(options.json, about, content)


if __name__ == "__main__":
    main()
