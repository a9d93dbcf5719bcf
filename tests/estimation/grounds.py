"""A decision problem whose values are known, and policies for it: shared by the tests of the estimators."""

import dataclasses

import jax.numpy as jnp
import jax.random as jr
import numpy as np

from odaf.components.networks import init_mlp
from odaf.components.policies import DeterministicActor, GaussianActor
from odaf.data import Dataset
from odaf.data.normalisation import Normaliser
from odaf.estimation import EstimateSettings
from odaf.training.policy import Policy

SMALL = EstimateSettings(
    members=4,
    hidden_sizes=(32, 32),
    steps=1_500,
    batch_size=64,
    learning_rate=2e-3,
    resamples=200,
    early_stopping=False,
)
HORIZON, CHANCE, ACTION = 5, 0.3, 0.4


def gliding(episodes: int, ends: bool, seed: int = 0, scale: float = 1.0) -> Dataset:
    """s' = 0.7 s + 0.3 a, reward s + a for uniform actions; where told, an end with probability 0.3 a step."""
    rng = np.random.default_rng(seed)
    columns: dict[str, list[float]] = {"s": [], "a": [], "r": [], "n": [], "d": [], "t": []}
    for _ in range(episodes):
        state = float(rng.uniform(-1, 1))
        for step in range(HORIZON):
            action = float(rng.uniform(-1, 1))
            ended = bool(ends and rng.random() < CHANCE)
            last = step == HORIZON - 1 and not ended
            following = 0.7 * state + 0.3 * action
            row = (state, action, scale * (state + action), following, ended, last)
            for name, value in zip("sarndt", row, strict=True):
                columns[name].append(value)
            if ended:
                break
            state = following
    s, a, r, n, d, t = (np.array(columns[name]) for name in "sarndt")
    uniform = np.full(len(s), np.log(0.5))
    return Dataset.from_arrays(
        s[:, None],
        a[:, None],
        r,
        n[:, None],
        d.astype(bool),
        t.astype(bool),
        action_bounds=(-1.0, 1.0),
        infos={"logp": uniform.astype(np.float32)},
    )


def known_value(states: np.ndarray, ends: float, discount: float = 1.0, action: float = ACTION) -> np.ndarray:
    """Expected sum to the horizon of a policy whose actions have this mean, where a step ends with this chance."""
    stays, total, states = 1.0, np.zeros(len(states)), states.astype(np.float64)
    for _ in range(HORIZON):
        total = total + stays * (states + action)
        states, stays = 0.7 * states + 0.3 * action, stays * discount * (1.0 - ends)
    return total


def constant(dataset: Dataset, action: float = ACTION) -> Policy:
    """Takes one action everywhere."""
    network = init_mlp(jr.key(0), (1, 4, 1))
    silent = dataclasses.replace(
        network,
        weights=(network.weights[0], jnp.zeros_like(network.weights[1])),
        biases=(network.biases[0], jnp.full((1,), np.arctanh(action), jnp.float32)),
    )
    return Policy(
        DeterministicActor(silent), Normaliser.fit(dataset.observations), (-1.0,), (1.0,), dataset.observation_names
    )


def gaussian(dataset: Dataset, mean: float, log_std: float) -> Policy:
    """tanh of one Gaussian everywhere."""
    network = init_mlp(jr.key(0), (1, 4, 2))
    silent = dataclasses.replace(
        network,
        weights=(network.weights[0], jnp.zeros_like(network.weights[1])),
        biases=(network.biases[0], jnp.asarray([mean, log_std], jnp.float32)),
    )
    return Policy(
        GaussianActor(silent), Normaliser.fit(dataset.observations), (-1.0,), (1.0,), dataset.observation_names
    )
