"""A start from the log: critics fitted to the returns that followed, the actor to the actions that were taken.

    L_Q  = sum_k mean_B ( Q_k(s, a) - G )^2,      G = discounted sum of the rewards from this row to its episode's end
    L_pi = - mean_B log pi(a|s)

Fresh critics climb to the size of the returns at the pace of the optimiser, and the Bellman targets carry values back
at the pace of the slow copies. Both clocks are skipped by fitting the logged returns first. These are the values of
whoever acted in the log; training takes them from there.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import optax
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.components.critics import CriticEnsemble
from odaf.components.distributions import tanh_gaussian_log_density
from odaf.components.losses import ensemble_td_gradient
from odaf.components.policies import GaussianActor
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser, scale_actions

STRETCH = 500
LARGEST_ACTION = 0.999  # logged actions are cut to this: the density of +-1 itself is infinite


def returns_to_go(dataset: Dataset, discount: float) -> Float[np.ndarray, " rows"]:
    """G of every row, in the units of the rewards.

    An episode that was cut, by a time limit or by the end of the log, is taken to go on earning the mean reward of its
    rows; one that truly ended earns nothing more.
    """
    from scipy.signal import lfilter  # takes a second to load, so only where it is used

    found = np.empty(len(dataset), np.float64)
    for index in range(dataset.num_episodes):
        rows = dataset.episode(index)
        rewards = dataset.rewards[rows].astype(np.float64)
        rest = 0.0 if dataset.terminated[rows][-1] else rewards.mean() / (1.0 - discount)
        backwards, _ = lfilter([1.0], [1.0, -discount], rewards[::-1], zi=[discount * rest])
        found[rows] = backwards[::-1]
    return found.astype(np.float32)


def fit_to_log(
    actor: GaussianActor,
    critics: CriticEnsemble,
    dataset: Dataset,
    normaliser: Normaliser,
    returns: Float[np.ndarray, " rows"],
    key: PRNGKeyArray,
    *,
    steps: int,
    batch_size: int,
    learning_rate: float,
    progress: Callable[[int, int], None],
) -> tuple[GaussianActor, CriticEnsemble, dict[str, float]]:
    """Adam on both losses, with fresh moments that are thrown away afterwards.

    Args:
        actor: where the actor starts.
        critics: where the critics start.
        dataset: the log.
        normaliser: its observation scaling.
        returns: what the critics are fitted to, in their own units.
        key: random key; chooses the batches.
        steps: updates.
        batch_size: rows an update.
        learning_rate: step size.
        progress: called with (steps done, steps in all).

    Returns:
        The fitted networks, and the losses of the last stretch: mean squared error of the critics over rows and members
        as a share of the returns' variance, and the actor's log-density in nats.
    """
    scaled = np.clip(
        scale_actions(dataset.actions, dataset.action_low, dataset.action_high), -LARGEST_ACTION, LARGEST_ACTION
    )
    columns = tuple(map(jnp.asarray, (normaliser.normalise(dataset.observations), scaled, returns)))
    optimiser = optax.adam(learning_rate)

    @partial(jax.jit, donate_argnums=0)
    def stretch(carry: PyTree, columns: tuple[Array, ...], keys: Array) -> tuple[PyTree, tuple[Array, Array]]:
        def step(carry: PyTree, key: PRNGKeyArray) -> tuple[PyTree, tuple[Array, Array]]:
            networks, moments = carry
            rows = jr.randint(key, (batch_size,), 0, returns.shape[0])
            observations, actions, targets = (column[rows] for column in columns)
            critic_gradient, critic_loss, _ = ensemble_td_gradient(networks[1], observations, actions, targets)

            def cloning_loss(actor: GaussianActor) -> Float[Array, ""]:
                return -jnp.mean(tanh_gaussian_log_density(*actor.parameters(observations), actions))

            actor_loss, actor_gradient = jax.value_and_grad(cloning_loss)(networks[0])
            gradient: PyTree = (actor_gradient, critic_gradient)
            updates, moments = optimiser.update(gradient, moments, networks)
            return (optax.apply_updates(networks, updates), moments), (actor_loss, critic_loss)

        carry, losses = jax.lax.scan(step, carry, keys)
        return carry, jax.tree.map(jnp.mean, losses)

    networks: PyTree = (actor, critics)
    carry = jax.tree.map(jnp.copy, (networks, optimiser.init(networks)))
    keys = jr.split(key, steps)
    losses = jnp.nan, jnp.nan
    for done in range(0, steps, STRETCH):
        carry, losses = stretch(carry, columns, keys[done : done + STRETCH])
        jax.block_until_ready(losses)
        progress(min(done + STRETCH, steps), steps)
    (actor, critics), _ = carry
    members = critics.networks.biases[0].shape[0]
    error = float(losses[1]) / members / max(float(np.var(returns)), 1e-12)
    return actor, critics, {"value_error_share": error, "action_log_density": -float(losses[0])}
