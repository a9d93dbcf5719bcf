"""Throughput against the number of lanes: trainings in one compiled program, beside the same trainings in processes.

For each learner and number of lanes: updates a second of all lanes together, seconds to compile, and the memory that
the program takes. On a processor the same trainings are also made in processes, one a core, in rounds that take turns
with the lanes; that is what `odaf train` does there.

`--course N` also trains the most lanes for N updates as a user does, with what is fitted beforehand and evaluations in
the maze that the package ships, once played beside the training and once not; its seconds are those of the runs' own
records. `--peers DIR` times the peers whose code lies there (a checkout of CORL).

    python benchmarks/lanes.py --sizes 64 64 --critics 4 --lanes 8 --json benchmarks/last/lanes.json
    python benchmarks/lanes.py --lanes 1 4 16 64 --updates 1000 --course 20000 --peers ../CORL
"""

import argparse
import functools
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax
import jax.random as jr

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import odaf
from benchmarks import learners
from benchmarks.machine import machine, write_figures
from odaf.environments import stitch_data
from odaf.runs import presets
from odaf.runs.workers import cores, run_jobs
from odaf.training import loop
from odaf.training.settings import Precision, RunSettings, products_in

_PEER = Path("algorithms", "offline", "sac_n.py")  # of CORL

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


def course(setting: Setting, lanes: int, steps: int, workers: int, precision: Precision) -> dict[str, float]:
    """Seconds of a whole run of so many seeds in lanes, by what they went to; those of `evaluate` are waited for."""
    with tempfile.TemporaryDirectory(prefix="odaf-lanes-") as folder:
        file = Path(folder, "maze.h5")
        stitch_data.generate(stitch_data.CONFIGS["stitch"].with_repeats(8), seed=0).save(file)
        every = max(1, steps // 4)
        run = odaf.fit(
            learner(setting), file, directory=Path(folder, "run"), steps=steps, seeds=range(lanes), lanes=lanes,
            workers=workers, evaluate=odaf.Rollouts(episodes=5, every=every), checkpoint_every=every,
            precision=precision, progress=False,
        )  # fmt: skip
        seconds = [summary["seconds"] for summary in run.summary.values()]
    return {name: max(each[name] for each in seconds) for name in ("pretrain", "compile", "train", "evaluate", "total")}


def peers(folder: Path, python: str) -> dict[str, Any]:
    """Figures of the peers whose code lies in the folder; what is missing is said."""
    if not (folder / _PEER).is_file():
        print(f"--peers {folder}: no {_PEER} there, so no peer is timed; give a checkout of CORL")
        return {}
    command = [python, str(Path(__file__).with_name("peer_corl.py")), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        print(f"--peers {folder}: {done.stderr.strip().splitlines()[-1]}; --peer-python names one that has PyTorch")
        return {}
    found = json.loads(done.stdout.splitlines()[-1])
    for name, figures in found.items():
        print(f"{name}: {figures['updates_per_second']:,.0f} updates/s, {figures['products']} products")
    return found


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
    parser.add_argument("--course", type=int, metavar="UPDATES", help="also train the most lanes so long, in the maze")
    parser.add_argument("--precision", choices=["float32", "tensorfloat32"], default="float32", help="of the products")
    parser.add_argument("--peers", type=Path, metavar="DIR", help="a folder of peers' code")
    parser.add_argument("--peer-python", default=sys.executable, help="interpreter that the peers need")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args(arguments)
    RunSettings(precision=options.precision).resolved()  # refuses what this device does not have
    with products_in(options.precision):
        measure(options)


def measure(options: argparse.Namespace) -> None:
    """Each learner, one line for each number of lanes."""

    about, figures, courses = machine(), [], []
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
                    "products": options.precision,
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
        if options.course:
            lanes = max(options.lanes)
            for way, workers in (("beside", max(2, cores() - 1)), ("waited for", 1)):
                seconds = course(setting, lanes, options.course, workers, options.precision)
                courses.append(
                    {"learner": preset, "lanes": lanes, "updates": options.course, "evaluation": way, **seconds}
                )
                words = ", ".join(f"{name} {value:.0f} s" for name, value in seconds.items())
                print(f"{preset}, {lanes} lanes of {options.course:,} updates, evaluation {way}: {words}", flush=True)
                write_figures(options.json, about, {"figures": figures, "courses": courses})
    if options.peers is not None:
        found = peers(options.peers, options.peer_python)
        write_figures(options.json, about, {"figures": figures, "courses": courses, "peers": found})


if __name__ == "__main__":
    main()
