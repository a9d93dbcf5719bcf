"""Seconds from the command to its first update, and peak memory of training, on a log of a million transitions.

`odaf train` is run as a user would, for one update with everything that comes before and after it, three times with one
empty folder for compiled programs: what the second run saves is the compiler, and the third, in which numbers of the
preset are others, must not need it either. A fourth, longer run shows that memory does not grow. At last two seeds are
trained in one process, for one update each: the second one's side models must not wait for the compiler. Learners with
side models get one step of their training, which would otherwise be what is measured. Memory is the process's own peak,
libraries and compiler included.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.load_dataset import ROWS, write
from benchmarks.machine import machine, write_figures

COUNTED = Path(__file__).parent / "counted.py"
# Options of every run: one step for each side model.
LEARNERS: dict[str, list[str]] = {
    "sac-n": [],
    "edac": [],
    "odaf": ["--outcome.dynamics.steps", "1"],
    "odaf-locomotion": ["--outcome.dynamics.steps", "1", "--warm-start-steps", "1"],
}
# Numbers that the third run changes.
CHANGES: dict[str, list[str]] = {
    "sac-n": ["--discount", "0.97"],
    "edac": ["--actor-learning-rate", "1e-4", "--diversity.weight", "0.5"],
    "odaf": ["--critic-learning-rate", "1e-4", "--outcome.weight", "0.7", "--outcome.radius", "0.02"],
    "odaf-locomotion": ["--actor-learning-rate", "1e-4", "--outcome.weight", "0.7"],
}


def run(learner: str, data: Path, folder: Path, *options: str) -> dict[str, Any]:
    """Seconds, processor seconds, peak bytes and programs of one `odaf train`, loaded and compiled."""
    out, counts = folder / f"run-{time.monotonic_ns()}", folder / "counts.json"
    command = [sys.executable, str(COUNTED), str(counts), "train", learner, "--data", str(data), "--out", str(out)]
    command += ["--hidden-sizes", "256", "256", "256", "--quiet", *LEARNERS[learner], *options]
    start = time.perf_counter()
    with (folder / "errors.txt").open("w+") as errors:
        process = subprocess.Popen(
            command,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            env={**os.environ, "ODAF_CACHE_DIR": str(folder / "cache")},
        )
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            errors.seek(0)
            raise SystemExit(f"{' '.join(command)} failed:\n{errors.read()}")
    return {
        "seconds": time.perf_counter() - start,
        "processor_seconds": used.ru_utime + used.ru_stime,
        "peak_bytes": used.ru_maxrss * (1 if sys.platform == "darwin" else 1024),
        **{f"programs_{how}": number for how, number in json.loads(counts.read_text()).items()},
        "pretrain_seconds": {path.parent.name: _pretraining(path) for path in sorted(out.glob("seed-*/summary.json"))},
    }


def _pretraining(summary: Path) -> float:
    """Seconds that a seed spent on its side models, from its summary."""
    return json.loads(summary.read_text())["seconds"]["pretrain"]


def main(arguments: list[str] | None = None) -> None:
    """Measure each learner, print one line each, and write the figures if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=ROWS, help="transitions of 17 + 6 numbers")
    parser.add_argument("--learners", nargs="+", default=list(LEARNERS), choices=list(LEARNERS))
    parser.add_argument("--updates", type=int, default=100, help="updates of the longer run")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args(arguments)

    about, figures = machine(), {}
    with tempfile.TemporaryDirectory() as name:
        data = Path(name) / "log.hdf5"
        write(data, options.rows, "odaf")
        for learner in options.learners:
            one = ["--steps", "1"]
            with tempfile.TemporaryDirectory(dir=name) as folder:
                runs = {
                    "compiling": run(learner, data, Path(folder), *one),
                    "compiled_before": run(learner, data, Path(folder), *one),
                    "changed_number": run(learner, data, Path(folder), *one, *CHANGES[learner]),
                    "longer": run(learner, data, Path(folder), "--steps", str(options.updates)),
                }
            with tempfile.TemporaryDirectory(dir=name) as folder:  # an empty one: nothing to load
                runs["two_seeds"] = run(learner, data, Path(folder), *one, "--seeds", "0", "1", "--workers", "1")
            for what in ("compiling", "compiled_before", "changed_number"):
                print(
                    f"{learner}, {what.replace('_', ' ')}: first update after {runs[what]['seconds']:.1f} s "
                    f"({runs[what]['processor_seconds']:.1f} s of processor); programs compiled "
                    f"{runs[what]['programs_compiled']}, loaded {runs[what]['programs_loaded']}"
                )
            first, second = runs["two_seeds"]["pretrain_seconds"].values()
            print(f"{learner}: one step of the side models of seed 0 takes {first:.2f} s, of seed 1 {second:.2f} s")
            alone = [each["peak_bytes"] for name, each in runs.items() if name != "two_seeds"]
            figures[learner] = {**runs, "peak_bytes": max(alone)}
            print(f"{learner}: peak memory {figures[learner]['peak_bytes'] / 1e9:.2f} GB", flush=True)
    write_figures(options.json, about, {"transitions": options.rows, "learners": figures})


if __name__ == "__main__":
    main()
