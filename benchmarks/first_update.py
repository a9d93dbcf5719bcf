"""Seconds from the command to its first update, and peak memory of training, on a log of a million transitions.

`odaf train` is run as a user would, for one update with everything that comes before and after it, twice with one empty
folder for compiled programs: what the second run saves is the compiler. A third, longer run shows that memory does not
grow. Learners with a side model get one step of its training, which would otherwise be what is measured. Memory is the
process's own peak, libraries and compiler included.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.load_dataset import ROWS, write
from benchmarks.machine import machine, write_figures

LEARNERS = {"sac-n": [], "edac": [], "odaf": ["--outcome.dynamics.steps", "1"]}


def run(learner: str, data: Path, folder: Path, steps: int) -> dict[str, float]:
    """Seconds, processor seconds and peak bytes of one `odaf train`."""
    out = folder / f"run-{time.monotonic_ns()}"
    command = [sys.executable, "-m", "odaf", "train", learner, "--data", str(data), "--out", str(out)]
    command += ["--steps", str(steps), "--hidden-sizes", "256", "256", "256", "--quiet", *LEARNERS[learner]]
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
    }


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
            with tempfile.TemporaryDirectory(dir=name) as folder:
                first, again, longer = (run(learner, data, Path(folder), steps) for steps in (1, 1, options.updates))
            peak = max(each["peak_bytes"] for each in (first, again, longer))
            figures[learner] = {"compiling": first, "compiled_before": again, "longer": longer, "peak_bytes": peak}
            for what, each in (("first update", first), ("when compiled before", again)):
                print(f"{learner}: {what} {each['seconds']:.1f} s ({each['processor_seconds']:.1f} s of processor)")
            print(f"{learner}: peak memory {peak / 1e9:.2f} GB", flush=True)
    write_figures(options.json, about, {"transitions": options.rows, "learners": figures})


if __name__ == "__main__":
    main()
