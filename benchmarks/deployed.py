"""Microseconds an action in the forms that `odaf export` writes, for Hopper's shapes: 11 numbers in, 3 out, 2 x 256.

Timed are `policy_act` of `policy.h`, compiled with the options that are named, and `Policy.act` of `odaf_policy.py` on
a NumPy row; both check their input, normalise, act, and map to the bounds. Each is called many times in a row, for
many rounds. The figure is the quickest round, since others use the machine too; the median stands beside it. One core:
what NumPy multiplies with takes one thread. With `--guard` the policy has a guard of four critics and dynamics at
2 x 256, and 1,024 reference rows, all with random parameters.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.acting import policy_of
from benchmarks.machine import machine, write_figures
from odaf.components.critics import CriticEnsemble, init_critics
from odaf.components.dynamics import DynamicsConfig, untrained
from odaf.deployment import GuardedPolicy, export, odaf_policy
from odaf.deployment.check import compiler
from odaf.deployment.conformal import Calibration
from odaf.deployment.score import PARTS, GuardScore
from odaf.errors import ConfigError
from odaf.training.policy import Policy

FLAGS = ("-std=c99 -O2", "-std=c99 -O3", "-std=c99 -O3 -march=native")
_TIMED = """\
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <time.h>
#include "policy.h"
int main(void)
{
    float row[POLICY_OBSERVATIONS], act[POLICY_ACTIONS], sum = 0.0f;
    for (int round = 0; round < ROUNDS; ++round) {
        struct timespec began, ended;
        clock_gettime(CLOCK_MONOTONIC, &began);
        for (int call = 0; call < CALLS; ++call) {
            for (int k = 0; k < POLICY_OBSERVATIONS; ++k)
                row[k] = 0.01f * (float)((call * 7 + k * 13) % 200 - 100);
            if (policy_act(row, act) % 4 == 0) sum += act[0] + act[1] + act[2];
        }
        clock_gettime(CLOCK_MONOTONIC, &ended);
        const double seconds = ended.tv_sec - began.tv_sec, nanoseconds = ended.tv_nsec - began.tv_nsec;
        printf("%.9g\\n", (seconds + 1e-9 * nanoseconds) / CALLS);
    }
    fprintf(stderr, "%g\\n", sum);
    return 0;
}
"""


def guarded(policy: Policy) -> GuardedPolicy:
    """The policy with a guard of random parameters."""
    obs, act, hidden = policy.obs_dim, policy.act_dim, (256, 256)
    keys, rng = jax.random.split(jax.random.key(0)), np.random.default_rng(0)
    numbers = {
        "mean": policy.normaliser.mean,
        "inverse_scale": 1.0 / policy.normaliser.scale,
        "centre": policy.normaliser.mean,
        "half_width": 3.0 * policy.normaliser.std,
        "whitening": np.eye(obs + act),
        "points": rng.normal(size=(1_024, obs + act)),
        "error_whitening": np.eye(obs),
        "levels": np.ones(len(PARTS)),
    }
    score = GuardScore(
        untrained(DynamicsConfig(hidden_sizes=hidden), keys[0], obs, act),
        CriticEnsemble(init_critics(keys[1], obs, act, hidden, 4, "layer", None)),
        **{name: jnp.asarray(array, jnp.float32) for name, array in numbers.items()},
    )
    facts = {"alarms": 0, "policy_alarms": 0, "alarms_by_part": {}, "critics": "", "dynamics": "", "notes": []}
    return GuardedPolicy(policy, score, Calibration(5.0, 0.01, 0.01, 99, None, 1), "warn", None, facts)


def of_c(folder: Path, command: str, flags: str, rounds: int, calls: int) -> np.ndarray:
    """[rounds] seconds a call."""
    (folder / "timed.c").write_text(_TIMED)
    sizes = [f"-DROUNDS={rounds}", f"-DCALLS={calls}"]
    subprocess.run([command, *flags.split(), *sizes, "timed.c", "-lm", "-o", "timed"], cwd=folder, check=True)
    done = subprocess.run([folder / "timed"], capture_output=True, text=True, check=True)
    return np.array([float(line) for line in done.stdout.split()])


def of_numpy(folder: Path, rounds: int, calls: int) -> np.ndarray:
    """[rounds] seconds a call."""
    policy = odaf_policy.Policy(folder / "policy.safetensors")
    row = np.random.default_rng(1).normal(size=len(policy.columns)).astype(np.float32)
    seconds = []
    for _ in range(rounds):
        began = time.perf_counter()
        for _ in range(calls):
            policy.act(row)
        seconds.append((time.perf_counter() - began) / calls)
    return np.array(seconds)


def main(arguments: list[str] | None = None) -> None:
    """Measure, print a line each, and write the figures if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--learner", default="odaf", help="preset whose policy acts")
    parser.add_argument("--guard", action="store_true", help="with a guard")
    parser.add_argument("--rounds", type=int, default=40, help="of each")
    parser.add_argument("--calls", type=int, default=200, help="a round")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args(arguments)

    about, command = machine(), compiler()
    if command is None:
        raise ConfigError("benchmarks/deployed.py: needs a C compiler; install one, or name one in CC")
    version = subprocess.run([command, "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[0]
    figures: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "out"
        policy = policy_of(options.learner)
        export(guarded(policy) if options.guard else policy, folder, forms=["numpy", "c"])
        timed = {
            f"C, {version}, {flags}": of_c(folder, command, flags, options.rounds, options.calls) for flags in FLAGS
        }
        timed[f"NumPy {np.__version__}, one thread"] = of_numpy(folder, options.rounds, options.calls)
    for what, seconds in timed.items():
        figures[what] = {"quickest": float(seconds.min()) * 1e6, "median": float(np.median(seconds)) * 1e6}
        print(f"{what}: {figures[what]['quickest']:.1f} us an action, median {figures[what]['median']:.1f} us")
    write_figures(options.json, about, {"learner": options.learner, "guard": options.guard, "microseconds": figures})


if __name__ == "__main__":
    main()
