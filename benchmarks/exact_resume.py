"""Whether lanes that are killed go on to the bits of lanes that are not: kill -9, the same call again, all compared.

    python benchmarks/exact_resume.py --steps 20000
    XLA_FLAGS=--xla_gpu_deterministic_ops=true python benchmarks/exact_resume.py --steps 20000    # on a GPU

Eight lanes are trained twice, in processes of their own. The second process is killed once its first lane has made a
third of the updates, and started again. Leaves with 1 if any state or any line of metrics differs, with 2 if the
training was over before it could be killed. On a GPU without that flag sums come in no fixed order, and it says so.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any


def train(directory: Path, options: argparse.Namespace) -> None:
    """In a process of its own: one run of as many seeds as lanes, on rows of random numbers."""
    import numpy as np

    import odaf
    from odaf.runs import presets

    random, rows = np.random.default_rng(0), 20_000
    ends = np.arange(rows) % 1000 == 999
    log = odaf.Dataset.from_arrays(
        random.normal(size=(rows, 11)),
        random.uniform(-1.0, 1.0, (rows, 3)),
        random.uniform(size=rows),
        terminated=np.zeros(rows, bool),
        truncated=ends,
        action_bounds=(-1.0, 1.0),
    )
    learner: Any = presets.load(options.preset, {"hidden_sizes": tuple(options.sizes)})
    lanes, every = options.lanes, max(1, options.steps // 6)
    odaf.fit(
        learner, log, directory=directory, steps=options.steps, seeds=range(lanes), lanes=lanes,
        checkpoint_every=every, stretch=every, keep_checkpoints="all", progress=False,
    )  # fmt: skip


def newest(directory: Path, seed: int = 0) -> int:
    """Updates of a seed's last checkpoint; -1 where there is none."""
    found = (directory / f"seed-{seed}" / "checkpoints").glob("*/header.json")
    return max((int(header.parent.name) for header in found if header.parent.name.isdigit()), default=-1)


def differences(one: Path, other: Path) -> list[str]:
    """Checkpoints and lines of metrics that are not the same in both runs."""
    found = []
    for state in sorted(one.glob("seed-*/checkpoints/*/state.eqx")):
        twin = other / state.relative_to(one)
        if not twin.exists() or twin.read_bytes() != state.read_bytes():
            found.append(str(state.relative_to(one)))
    for metrics in sorted(one.glob("seed-*/metrics.jsonl")):
        if _lines(metrics) != _lines(other / metrics.relative_to(one)):
            found.append(str(metrics.relative_to(one)))
    return found


def _lines(metrics: Path) -> list[dict[str, Any]]:
    lines = [json.loads(line) for line in metrics.read_text(encoding="utf-8").splitlines()]
    return [{name: value for name, value in line.items() if not name.startswith("time/")} for line in lines]


def main(arguments: list[str] | None = None) -> int:
    """Train unbroken and broken, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--preset", default="sac-n")
    parser.add_argument("--sizes", nargs="+", type=int, default=[256, 256], help="units of each hidden layer")
    parser.add_argument("--lanes", type=int, default=8)
    parser.add_argument("--steps", type=int, default=20_000, help="updates of each lane")
    parser.add_argument("--train", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.train is not None:
        train(options.train, options)
        return 0

    own = ["--preset", options.preset, "--lanes", str(options.lanes), "--steps", str(options.steps), "--sizes"]
    command = [sys.executable, __file__, *own, *map(str, options.sizes), "--train"]
    source = str(Path(__file__).resolve().parents[1] / "src")
    path = os.pathsep.join(filter(None, (source, os.environ.get("PYTHONPATH"))))
    environment = {**os.environ, "PYTHONPATH": path}
    with tempfile.TemporaryDirectory(prefix="odaf-resume-") as folder:
        unbroken, broken = Path(folder, "unbroken"), Path(folder, "broken")
        subprocess.run([*command, str(unbroken)], env=environment, check=True)
        process = subprocess.Popen([*command, str(broken)], env=environment)
        while process.poll() is None and newest(broken) < options.steps // 3:
            time.sleep(0.02)
        if process.poll() is not None:
            print("the training ended before it could be killed; take more --steps", file=sys.stderr)
            return 2
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
        print(f"killed after update {newest(broken):,} of {options.steps:,}")
        subprocess.run([*command, str(broken)], env=environment, check=True)
        different = differences(unbroken, broken)
        device = json.loads((unbroken / "environment.json").read_text(encoding="utf-8"))["device"]
    if different:
        print(f"{device}: not the bits of an unbroken training, in {len(different)} files: {', '.join(different[:4])}")
        return 1
    print(f"{device}: {options.lanes} lanes went on to the bits of an unbroken training")
    return 0


if __name__ == "__main__":
    sys.exit(main())
