"""How many updates a second each learner makes, beside what the machine's matrix products allow.

The ceiling is the batched product (10, 256, 256) x (10, 256, 256) of the compiler that trains, measured in the same
rounds as the learners, so that a slow or busy machine slows both. Operations are counted by hand: operations.py holds
the table. docs/results/speed.md says how to read the figures and where the time goes.

With `--others` the learners that are no ensembles are measured instead, at the sizes that they are published with.
d3rlpy takes its turn in the same rounds (`--peer-python`), and each learner is laid beside what is asked of it:
`FLOORS`, as far as the machine's products allow, and `TIMES_D3RLPY`.
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
from benchmarks.parity.settings import LEARNERS

ROOT = Path(__file__).resolve().parents[1]
PEERS = ("sac-n", "fqe", *LEARNERS)  # that d3rlpy has too

PRODUCTS = 50  # in one call of the ceiling
FLOP_OF_CEILING = 2.0 * PRODUCTS * 10 * 256**3

# Updates a second of the fastest public JAX code, measured where the ceiling was `CEILING_OF_FLOORS`.
FLOORS = {"iql": 513.0, "td3-bc": 455.0, "cql": 32.8}
CEILING_OF_FLOORS = 330.0  # GFLOP/s
TIMES_D3RLPY = {"iql": 4.0, "td3-bc": 4.0, "cql": 2.0, "bcq": 2.0, "bear": 2.0}


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


class Peer:
    """d3rlpy in an interpreter of its own, which waits while others are measured.

    Args:
        python: the interpreter; None has no learner.
    """

    def __init__(self, python: Path | None):
        self.speeds: dict[str, list[float]] = {}
        self.what: dict[str, str] = {}
        self._process = None
        if python is not None:
            command = [python, "-m", "benchmarks.peer_d3rlpy"]
            self._process = subprocess.Popen(
                command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
            )

    def measure(self, name: str, seconds: float) -> None:
        """Times a learner for about so long, if d3rlpy has it."""
        if self._process is None or name.partition(":")[0] not in PEERS:
            return
        assert self._process.stdin is not None and self._process.stdout is not None
        print(name, seconds, file=self._process.stdin, flush=True)
        for line in self._process.stdout:  # its log stands before
            if line.startswith("{"):
                answer = json.loads(line)
                self.speeds.setdefault(name, []).append(answer["updates_per_second"])
                self.what[name] = answer["what"]
                return
        raise SystemExit(f"{name}: d3rlpy's process ended; `python -m benchmarks.peer_d3rlpy` shows why")

    def close(self) -> None:
        """Ends the process."""
        if self._process is not None:
            self._process.communicate()


def measure(names: list[str], rounds: int, seconds: float, peer: Peer) -> dict:
    """Compile all, then go through them in turn; medians over the rounds."""
    product, calls, counts, compiled = ceiling(), {}, {}, {}
    product()
    for name in names:
        algorithm = learners.load(name)
        calls[name] = learners.updates(algorithm, learners.columns(algorithm.view().extras))
        compiled[name] = seconds_of(lambda name=name: calls[name](1))
        counts[name] = max(1, round(seconds / seconds_of(lambda name=name: calls[name](2)) * 2))
        peer.measure(name, 0.0)  # builds it
        print(f"{name:20} compiled in {compiled[name]:5.1f} s, {counts[name]} updates a round", flush=True)
    peer.speeds.clear()
    times: dict[str, list[float]] = {name: [] for name in names}
    ceilings = []
    for _ in range(rounds):
        for name in names:
            ceilings.append(seconds_of(product))
            times[name].append(seconds_of(lambda name=name: calls[name](counts[name])))
            peer.measure(name, seconds)
    peer.close()
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
    peers = {
        name: {"updates_per_second": statistics.median(speeds), "rounds": speeds, "what": peer.what[name]}
        for name, speeds in peer.speeds.items()
    }
    asked = laid_beside({name: figures[name]["updates_per_second"] for name in names}, peers, peak)
    return {"ceiling_gflops": peak, "learners": figures, "peers": peers, "asked": asked}


def laid_beside(speeds: dict[str, float], peers: dict[str, dict], peak: float) -> dict[str, dict]:
    """What is asked of each learner and whether it is there; printed and returned.

    Args:
        speeds: of ours, updates a second.
        peers: of d3rlpy, by the same names.
        peak: the ceiling of this machine, GFLOP/s.
    """
    asked: dict[str, dict] = {}
    for name, speed in speeds.items():
        floor = FLOORS[name] * peak / CEILING_OF_FLOORS if name in FLOORS else None
        theirs = peers[name]["updates_per_second"] if name in peers else None
        if floor is None and theirs is None:
            continue
        least = max(floor or 0.0, TIMES_D3RLPY.get(name, 1.0) * (theirs or 0.0))
        asked[name] = {
            "floor": floor,
            "d3rlpy": theirs,
            "times_d3rlpy": None if theirs is None else speed / theirs,
            "times_asked": TIMES_D3RLPY.get(name),
            "holds": speed >= least,
        }
    if asked:
        print(f"\n{'':20} {'updates/s':>10} {'floor':>8} {'d3rlpy':>8} {'times':>7} {'asked':>7}")
    for name, row in asked.items():
        cells = [
            "" if row[key] is None else f"{row[key]:.1f}" for key in ("floor", "d3rlpy", "times_d3rlpy", "times_asked")
        ]
        verdict = "" if row["holds"] else "  too slow"
        print(f"{name:20} {speeds[name]:10.1f} {cells[0]:>8} {cells[1]:>8} {cells[2]:>7} {cells[3]:>7}{verdict}")
    return asked


def main(arguments: list[str] | None = None) -> None:
    """Measure in interleaved rounds, print the medians, and write them if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = (*learners.NAMES, *learners.OTHERS)
    parser.add_argument("--learners", nargs="+", default=list(learners.NAMES), choices=names)
    parser.add_argument("--others", action="store_true", help="the learners that are no ensembles, all of them")
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
        chosen = list(learners.OTHERS) if options.others else options.learners
        content = measure(chosen, rounds, seconds, Peer(options.peer_python))
    write_figures(options.json, about, content)


if __name__ == "__main__":
    main()
