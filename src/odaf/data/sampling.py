"""A dataset on the device, and batches drawn from it inside compiled code."""

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, PRNGKeyArray

from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser, scale_actions
from odaf.data.transitions import Transitions


def device_columns(dataset: Dataset, normaliser: Normaliser) -> Transitions:
    """All rows of `dataset` on the default device: observations normalised, actions scaled to [-1, 1]."""
    return Transitions(
        observations=jnp.asarray(normaliser.normalise(dataset.observations)),
        actions=jnp.asarray(scale_actions(dataset.actions, dataset.action_low, dataset.action_high)),
        rewards=jnp.asarray(dataset.rewards),
        next_observations=jnp.asarray(normaliser.normalise(dataset.next_observations)),
        terminated=jnp.asarray(dataset.terminated, jnp.float32),
    )


def sample(columns: Transitions, key: PRNGKeyArray | Array, batch_size: int) -> Transitions:
    """Draws `batch_size` rows uniformly with replacement; usable inside `jit`, `scan` and `vmap`.

    The rows are a function of `key` alone, so a resumed run that carries its key draws what an unbroken one would.
    """
    rows = jr.randint(key, (batch_size,), 0, columns.rewards.shape[0])
    return jax.tree.map(lambda column: column[rows], columns)
