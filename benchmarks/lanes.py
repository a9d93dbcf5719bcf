"""Throughput against the number of lanes: trainings in one compiled program, beside the same trainings in processes.

For each learner, precision and number of lanes: updates a second of all lanes together, seconds to compile, and the
memory that the program takes. On a processor the same trainings are also made in processes, one a core, in rounds that
take turns with the lanes; that is what `odaf train` does there.

`--sets 12` lets lanes draw from so many data sets of three robots, padded to the widest. `--trace DIR` says where the
time goes, by kind of operation. `--course N` also trains the most lanes for N updates as a user does, with what is
fitted beforehand and evaluations in the maze that the package ships, once played beside the training and once not; its
seconds are those of the runs' own records. `--peers DIR` times the peers whose code lies there (a checkout of CORL).

    python benchmarks/lanes.py --sizes 64 64 --critics 4 --lanes 8 --json benchmarks/last/lanes.json
    python benchmarks/lanes.py --lanes 1 4 16 64 --updates 1000 --course 20000 --peers ../CORL
    python benchmarks/lanes.py --learners rebrac sac-n --sizes 256 256 --critics 4 --sets 12 --lanes 60
    python benchmarks/lanes.py --learners sac-n --lanes 1 64 400 --trace runs/traces
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import jax

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import odaf
from benchmarks import learners
from benchmarks.lanes_problem import Lanes, Setting, compiled
from benchmarks.lanes_trace import traced
from benchmarks.machine import machine, write_figures
from odaf.environments import stitch_data
from odaf.runs.workers import cores, run_jobs
from odaf.training import loop
from odaf.training.settings import Precision, RunSettings, products_in

_PEER = Path("algorithms", "offline", "sac_n.py")  # of CORL
_MOST_TRACED = 20  # updates


def in_processes(setting: Setting, seeds: int, updates: int, wait: float) -> float:
    """Updates a second of as many trainings, in processes with a core each that take them one after another."""
    workers = min(seeds, cores())
    each = -(-seeds // workers)
    jobs = [(setting, seed, each * updates, time.time() + wait) for seed in range(workers)]
    return sum(speed for _, speed in run_jobs(_alone, jobs, workers=workers))


def _alone(job: tuple[Setting, int, int, float]) -> float:
    setting, seed, updates, start = job
    algorithm, rows, number = setting.learner(), setting.columns(seed), loop.update_number
    state = setting.state(seed)
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
            setting.learner(), file, directory=Path(folder, "run"), steps=steps, seeds=range(lanes), lanes=lanes,
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
    parser.add_argument("--sets", type=int, default=1, help="data sets; several are of three robots in turn")
    parser.add_argument("--rows", type=int, default=learners.ROWS, help="of each data set")
    parser.add_argument("--lanes", nargs="+", type=int, default=[1, 4, 16])
    parser.add_argument("--updates", type=int, default=200, help="updates of a lane in one round")
    parser.add_argument("--rounds", type=int, default=3, help="rounds; the median is reported")
    parser.add_argument("--wait", type=float, default=40.0, help="seconds in which every process must have compiled")
    parser.add_argument("--trace", type=Path, metavar="DIR", help="also trace each program, into folders of this one")
    parser.add_argument("--course", type=int, metavar="UPDATES", help="also train the most lanes so long, in the maze")
    parser.add_argument(
        "--precision", nargs="+", choices=["float32", "tensorfloat32"], default=["float32"], help="of the products"
    )
    parser.add_argument(
        "--products", choices=["float32", "tensorfloat32", "bfloat16"], help="of the critics' hidden layers alone"
    )
    parser.add_argument("--peers", type=Path, metavar="DIR", help="a folder of peers' code")
    parser.add_argument("--peer-python", default=sys.executable, help="interpreter that the peers need")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args(arguments)
    for precision in options.precision:
        RunSettings(precision=precision).resolved()  # refuses what this device does not have
    about = {**machine(), "xla_flags": os.environ.get("XLA_FLAGS", "")}
    found: dict[str, Any] = {"figures": [], "courses": []}
    settings = [
        Setting(
            preset, tuple(options.sizes), options.critics, options.batch, options.products, options.sets, options.rows
        )
        for preset in options.learners
    ]
    for precision in options.precision:
        with products_in(precision):
            for setting in settings:
                for lanes in options.lanes:
                    found["figures"].append(measured(setting, lanes, precision, options))
                    write_figures(options.json, about, found)  # so far: the time may end before the last
                for way in ("beside", "waited for") if options.course else ():
                    found["courses"].append(_course(setting, way, precision, options))
                    write_figures(options.json, about, found)
    if options.peers is not None:
        found["peers"] = peers(options.peers, options.peer_python)
        write_figures(options.json, about, found)


def measured(setting: Setting, lanes: int, precision: Precision, options: argparse.Namespace) -> dict[str, Any]:
    """The figures of one program, which are also printed."""
    program, seconds = compiled(setting, lanes)
    needs, held = program.memory_analysis(), Lanes(setting, program, lanes)
    speeds: dict[str, list[float]] = {"lanes": [], "processes": []}
    for _ in range(options.rounds):
        speeds["lanes"].append(lanes * options.updates / held.train(options.updates))
        if jax.default_backend() == "cpu":
            speeds["processes"].append(in_processes(setting, lanes, options.updates, options.wait))
    found = {way: statistics.median(taken) for way, taken in speeds.items() if taken}
    beside = f", in processes {found['processes']:,.0f}" if "processes" in found else ""
    print(
        f"{setting.preset} {setting.critics} x {list(setting.hidden_sizes)}, {setting.sets} data sets, {precision} "
        f"products, {lanes} lanes: {found['lanes']:,.0f} updates/s of all lanes together{beside}; compiled in "
        f"{seconds:.0f} s",
        flush=True,
    )
    figures = {
        "learner": setting.preset,
        "hidden_sizes": setting.hidden_sizes,
        "critics": setting.critics,
        "batch": setting.batch,
        "sets": setting.sets,
        "lanes": lanes,
        "products": precision,
        "critics_products": setting.products,
        "updates_per_second": found,
        "rounds": speeds,
        "compile_seconds": seconds,
        "program_bytes": needs and needs.temp_size_in_bytes + needs.output_size_in_bytes,
        "peak_bytes": (jax.devices()[0].memory_stats() or {}).get("peak_bytes_in_use"),
    }
    if options.trace is not None:
        updates = min(options.updates, _MOST_TRACED)
        folder = options.trace / f"{setting.preset}-{lanes}-{precision}"
        figures["trace"] = {"updates": updates, **traced(folder, lambda: held.train(updates))}
        parts = figures["trace"]["milliseconds"]
        whole = sum(parts.values()) or 1.0
        words = ", ".join(f"{kind} {taken / whole:.0%}" for kind, taken in parts.items())
        print(f"{setting.preset}, {lanes} lanes, {updates} updates: {words}; the trace is in {folder}", flush=True)
    return figures


def _course(setting: Setting, way: str, precision: Precision, options: argparse.Namespace) -> dict[str, Any]:
    lanes, workers = max(options.lanes), max(2, cores() - 1) if way == "beside" else 1
    seconds = course(setting, lanes, options.course, workers, precision)
    words = ", ".join(f"{name} {value:.0f} s" for name, value in seconds.items())
    what = f"{setting.preset}, {lanes} lanes of {options.course:,} updates, {precision} products"
    print(f"{what}, evaluation {way}: {words}", flush=True)
    about = {"learner": setting.preset, "lanes": lanes, "updates": options.course, "products": precision}
    return {**about, "evaluation": way, **seconds}


if __name__ == "__main__":
    main()
