"""What every export of a run needs: its snapshots as they will be shipped, and how the run is told in records."""

from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from odaf.behaviour.online import OnlineRun, load_policy
from odaf.environments.gaussian_policy import GaussianPolicy
from odaf.errors import ConfigError


def halved_snapshots(directory: Path, run: OnlineRun) -> dict[int, GaussianPolicy]:
    """The snapshots of a run by their step, as they will be after a trip through half precision.

    Raises:
        ConfigError: there are none yet.
    """
    paths = sorted((directory / "snapshots").glob("*.npz"))
    if not paths:
        raise ConfigError(f"{directory}: no snapshots yet; the first is written after {run.random_steps:,} steps")
    return {int(path.stem): _halved(load_policy(path)) for path in paths}


def training_record(run: OnlineRun, steps_made: int) -> dict[str, Any]:
    """How a run was made: learner, settings, and the command that makes it again."""
    settings = f"--seed {run.seed} --steps {run.steps} --batch-size {run.batch_size}"
    settings += "" if run.contact_margins is None else f" --contact-margins {run.contact_margins}"
    return {
        "algorithm": asdict(run.algorithm()),
        "run": asdict(run),
        "steps_made": steps_made,
        "command": f"odaf behaviour train {run.task} {settings}",
    }


def package_versions() -> dict[str, str]:
    """What must be the same for a run to give the same bits, beside the machine."""
    return {package: version(package) for package in ("jax", "gymnasium", "mujoco", "numpy")}


def _halved(policy: GaussianPolicy) -> GaussianPolicy:
    weights, biases = (
        [array.astype(np.float16).astype(np.float32) for array in arrays] for arrays in (policy.weights, policy.biases)
    )
    return GaussianPolicy(weights, biases)
