"""Two builds of odaf against each other: updates a second of every learner, in paired rounds on one machine.

Each build runs in a process of its own, on the learners of its own benchmarks/learners.py. The two take turns, which of
them goes first changes from round to round, and the ratio is taken round by round, so that a machine that slows down
slows both. The interval is Student's on the logarithm of the ratio.

    python benchmarks/paired.py --before ../odaf-0.1.0 --rounds 15 --json benchmarks/last/paired.json
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from scipy.stats import t as student

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.machine import machine, write_figures  # noqa: E402

LEARNERS = (
    "behaviour-cloning", "sac-n", "edac", "pbrl", "odaf-base", "odaf-default", "odaf", "odaf-sampled", "sac-n-bfloat16",
    "odaf-bfloat16", "odaf-paper", "rorl", "odaf-demo",
)  # fmt: skip
LEAST = 0.95

WORKER = """
import sys, time
from benchmarks import learners

rows, name = learners.columns(), sys.argv[1]
known = name in learners.NAMES
algorithm = learners.load(name) if known else learners.presets.load(name, {"hidden_sizes": (256, 256, 256)})
call = learners.updates(algorithm, rows)
call(1)
print("ready", flush=True)
for line in sys.stdin:
    began = time.perf_counter()
    call(int(line))
    print(time.perf_counter() - began, flush=True)
"""


class Build:
    """One learner of one build, compiled and waiting in a process of its own."""

    def __init__(self, root: Path, learner: str):
        paths = os.pathsep.join([str(root / "src"), str(root)])
        self._process = subprocess.Popen(
            [sys.executable, "-c", WORKER, learner],
            cwd=root,
            env={**os.environ, "PYTHONPATH": paths},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def wait(self) -> None:
        """Until the learner is compiled."""
        assert self._process.stdout is not None
        if self._process.stdout.readline().strip() != "ready":
            raise SystemExit(f"{self._process.args}: the build cannot run this learner")

    def seconds(self, updates: int) -> float:
        """Wall seconds of so many updates."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(f"{updates}\n")
        self._process.stdin.flush()
        return float(self._process.stdout.readline())

    def close(self) -> None:
        """Ends the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def compare(learner: str, before: Path, rounds: int, seconds: float) -> dict[str, float]:
    """Ratio of speeds, this build over the other one, with its 95 % interval, and both speeds' medians."""
    builds = {"before": Build(before, learner), "now": Build(ROOT, learner)}
    try:
        for build in builds.values():
            build.wait()
        count = max(1, round(2 * seconds / builds["before"].seconds(2)))
        builds["now"].seconds(2)
        taken: dict[str, list[float]] = {name: [] for name in builds}
        for index in range(rounds):
            for name in list(builds)[:: 1 if index % 2 else -1]:
                taken[name].append(builds[name].seconds(count))
    finally:
        for build in builds.values():
            build.close()
    logs = np.log(np.array(taken["before"]) / np.array(taken["now"]))
    half = student.ppf(0.975, rounds - 1) * logs.std(ddof=1) / np.sqrt(rounds)
    return {
        "ratio": float(np.exp(logs.mean())),
        "low": float(np.exp(logs.mean() - half)),
        "high": float(np.exp(logs.mean() + half)),
        "rounds": rounds,
        **{f"{name}_per_second": float(count / np.median(times)) for name, times in taken.items()},
    }


def main(arguments: list[str] | None = None) -> None:
    """Compare learner after learner, print a line each, and write the figures if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path, required=True, help="folder of the other build")
    parser.add_argument("--learners", nargs="+", default=list(LEARNERS))
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--seconds", type=float, default=1.0, help="about how long a learner runs in one round")
    parser.add_argument("--json", type=Path, help="file for the figures, written after every learner")
    options = parser.parse_args(arguments)
    about, figures = machine(), {}
    print(f"{'':20} {'ratio':>7} {'95 % interval':>18} {'before/s':>10} {'now/s':>10}", flush=True)
    for learner in options.learners:
        found = figures[learner] = compare(learner, options.before.resolve(), options.rounds, options.seconds)
        mark = "" if found["low"] > LEAST else f"  below {LEAST}"
        print(
            f"{learner:20} {found['ratio']:7.3f} {found['low']:8.3f} to {found['high']:6.3f} "
            f"{found['before_per_second']:10.1f} {found['now_per_second']:10.1f}{mark}",
            flush=True,
        )
        write_figures(options.json, about, {"learners": figures})
    print(json.dumps({name: round(found["low"], 3) for name, found in figures.items()}))


if __name__ == "__main__":
    main()
