"""Tiny decision problems, and several seeds of a learner trained on one side by side."""

import dataclasses

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np

from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.sampling import device_columns, sample

FAST = {"hidden_sizes": (32, 32), "batch_size": 64}


def trained(learner, dataset: Dataset, updates: int, seeds: int = 3, value_bounds=None):
    """States after training, stacked along a first axis of seeds; they share one pre-trained side network.

    Args:
        learner: settings.
        dataset: the log; observations are used as they are.
        updates: gradient steps.
        seeds: initial networks and noise.
        value_bounds: replaces the learner's own, one pair a seed.
    """
    normaliser, spec = Normaliser.identity(dataset.obs_dim), dataset.spec()
    columns = device_columns(dataset, normaliser, learner.view())
    models, _ = learner.pretrain(dataset, normaliser, jr.key(0), lambda *_: None)

    def run(key, bounds):
        key_init, key_train = jr.split(key)
        state = learner.init(key_init, spec, models)
        if bounds is not None:
            state = dataclasses.replace(state, value_bounds=bounds)

        def step(state, index):
            key_sample, key_update = jr.split(jr.fold_in(key_train, index))
            return learner.update(state, sample(columns, key_sample, learner.batch_size), key_update)[0], None

        return jax.lax.scan(step, state, jnp.arange(updates))[0]

    bounds = None if value_bounds is None else jnp.asarray(value_bounds, jnp.float32)
    return jax.jit(jax.vmap(run))(jr.split(jr.key(1), seeds), bounds)


def actions_at(learner, states, observation) -> np.ndarray:
    """[seeds, act_dim] deterministic actions at one observation."""
    row = jnp.asarray(observation, jnp.float32)[None, :]
    return np.asarray(jax.vmap(lambda state: learner.actor(state).mode(row)[0])(states))


def values_at(states, observation, actions) -> np.ndarray:
    """[seeds] mean over given actions [n, act_dim] of the lowest member's value at one observation."""
    actions = jnp.asarray(actions, jnp.float32)
    rows = jnp.broadcast_to(jnp.asarray(observation, jnp.float32)[None, :], (len(actions), len(observation)))
    return np.asarray(jax.vmap(lambda state: jnp.mean(jnp.min(state.online_critics(rows, actions), axis=0)))(states))


def rows(observations, actions, rewards, next_observations, terminated) -> Dataset:
    """A log whose every row is an episode of its own, cut by a time-out where the task did not end."""
    terminated = np.asarray(terminated, bool)
    return Dataset.from_arrays(
        np.asarray(observations, np.float32),
        np.asarray(actions, np.float32),
        np.asarray(rewards, np.float32),
        next_observations=np.asarray(next_observations, np.float32),
        terminated=terminated,
        truncated=~terminated,
        action_bounds=(-1.0, 1.0),
    )
