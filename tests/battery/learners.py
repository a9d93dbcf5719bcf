"""Every registered learner and every preset, small enough to be trained in a test."""

import dataclasses
from typing import Any

import numpy as np

from odaf.algorithms.base import Algorithm
from odaf.algorithms.registry import ALGORITHMS
from odaf.data.dataset import Dataset
from odaf.runs import presets

# What makes a learner small, by the name of its field, wherever it stands: in the learner, a term, or a model of one.
SMALL: dict[str, Any] = {
    "hidden_sizes": (5, 4),
    "actor_hidden_sizes": (5, 4),
    "critic_hidden_sizes": (5, 4),
    "behaviour_hidden_sizes": (5, 4),
    "warm_up_steps": 2,
    "num_candidates": 3,
    "batch_size": 6,
    "num_critics": 3,
    "steps": 3,
    "warm_start_steps": 3,
    "num_draws": 2,
    "num_actions": 2,
    "num_states": 4,
    "latent_dim": 2,
    "rollout_rows": 9,
    "horizon": 2,
    "retained": 2,
    "refresh_every": 3,
    "members": 3,
    "elites": 2,
    "epochs": 1,
    "epoch_steps": 3,
    "num_rollouts": 4,
    "round_size": 3,
    "max_rounds": 2,
}
KINDS = [kind for kind in ALGORITHMS if ALGORITHMS[kind].__module__.startswith("odaf.")]
PRESETS = list(presets.names())


def small(settings: Any) -> Any:
    """The same settings with few units, rows and steps."""
    changes: dict[str, Any] = {}
    for field in dataclasses.fields(settings):
        value: Any = getattr(settings, field.name)
        if field.name in SMALL and value != () and (value is not None or field.name == "epoch_steps"):
            changes[field.name] = SMALL[field.name]
        elif dataclasses.is_dataclass(value):
            changes[field.name] = small(value)
        elif field.name == "terms":
            changes[field.name] = tuple(small(term) for term in value or ())
    return dataclasses.replace(settings, **changes)


def of_kind(kind: str) -> Algorithm:
    """A registered learner with its own defaults, but small."""
    return small(ALGORITHMS[kind]())


def of_preset(name: str) -> Algorithm:
    """A preset, but small."""
    return small(presets.load(name))


def log(episodes: int = 6, length: int = 8, seed: int = 0) -> Dataset:
    """Episodes of a linear system in plain units; half of them truly end, the others are cut."""
    rng = np.random.default_rng(seed)
    rows = episodes * length
    observations = np.empty((rows, 3))
    actions = rng.uniform(-2.0, 4.0, (rows, 2))
    after = np.empty_like(observations)
    for row in range(rows):
        observations[row] = 10.0 * rng.normal(size=3) if row % length == 0 else after[row - 1]
        after[row] = 0.9 * observations[row] + np.array([1.0, 0.5, -1.0]) * actions[row].sum() + rng.normal(size=3)
    last = np.arange(rows) % length == length - 1
    falls = last & (np.arange(rows) // length % 2 == 0)
    return Dataset.from_arrays(
        observations,
        actions,
        -0.01 * np.abs(observations[:, 0]),
        next_observations=after,
        terminated=falls,
        truncated=last & ~falls,
        action_bounds=(-2.0, 4.0),
    )
