"""A plant's log, three policies learned from it, and what each is truly worth in the plant: one to run, two not to.

    python examples/two_tanks.py OUT

writes OUT/plant.csv, a data set for learning and one set aside, and a run for each policy. The simulator is kept aside:
it is asked at the end alone. `good` is ReBRAC, `cloned` imitates the operators, `undertrained` is ReBRAC after 200
updates.
"""

import dataclasses
import sys
from pathlib import Path
from typing import Any

import odaf
from odaf.environments.two_tanks import TwoTanks, read_log, write_log

SMALL: dict[str, Any] = {"hidden_sizes": (32, 32), "batch_size": 128}
VALUED: dict[str, Any] = {"discount": 0.95}  # of what learns from rewards
POLICIES: dict[str, tuple[str, int]] = {
    "good": ("rebrac", 8_000),
    "cloned": ("behaviour-cloning", 2_000),
    "undertrained": ("rebrac", 200),
}
"""Name to preset and updates."""


def train(name: str, data: Path, directory: Path) -> odaf.Run:
    """One of `POLICIES`."""
    preset, steps = POLICIES[name]
    changes = SMALL if preset == "behaviour-cloning" else SMALL | VALUED
    learner = dataclasses.replace(odaf.preset(preset), **changes)
    return odaf.fit(learner, data, steps=steps, seeds=[0], directory=directory, preset=preset)


def true_values(run: odaf.Run, episodes: int = 50) -> tuple[float, float]:
    """Mean profit of a shift and of a step, in the plant itself."""
    played = odaf.rollout(run.policy(0), TwoTanks, episodes)
    return float(played.returns.mean()), float(played.returns.sum() / played.lengths.sum())


def main(out: Path, shifts: int = 200) -> dict[str, tuple[float, float]]:
    """Everything; the true values by name."""
    out.mkdir(parents=True, exist_ok=True)
    write_log(out / "plant.csv", shifts)
    log = read_log(out / "plant.csv")
    learned, aside = log.split(holdout=0.5, seed=0)
    learned.save(out / "train.h5")
    aside.save(out / "holdout.h5")
    found = {}
    for name in POLICIES:
        found[name] = true_values(train(name, out / "train.h5", out / name))
        print(f"{name}: {found[name][0]:,.0f} a shift, {found[name][1]:.2f} a step")
    print(f"operators: {log.episode_returns().mean():,.0f} a shift, {log.rewards.mean():.2f} a step")
    return found


if __name__ == "__main__":
    main(Path(sys.argv[1]))
