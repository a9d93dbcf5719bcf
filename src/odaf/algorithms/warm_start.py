"""A start from the log: critics fitted to the returns that followed, the actor to the actions that were taken.

    L_Q  = sum_k mean_B ( Q_k(s, a) - G )^2,      G = discounted sum of the rewards from this row to its episode's end
    L_pi = - mean_B log pi(a|s)

Fresh critics climb to the size of the returns at the pace of the optimiser, and the Bellman targets carry values back
at the pace of the slow copies. Both clocks are skipped by fitting the logged returns first. These are the values of
whoever acted in the log; training takes them from there.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.critics import CriticEnsemble
from odaf.components.distributions import tanh_gaussian_log_density
from odaf.components.fitting import Batch, Progress, fit
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
    progress: Progress,
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
    fitted = fit(
        (actor, critics),
        _loss,
        tuple(map(jnp.asarray, (normaliser.normalise(dataset.observations), scaled, returns))),
        steps=steps,
        batch_size=batch_size,
        learning_rate=learning_rate,
        noisy=False,
        stretch=STRETCH,
        key=key,
        progress=progress,
        what="warm start",
        remedy="lower critic_learning_rate or check the log for outliers with `odaf data info`",
    )
    actor, critics = fitted.model
    members = critics.networks.biases[0].shape[0]
    error = fitted.means["critics"] / members / max(float(np.var(returns)), 1e-12)
    return actor, critics, {"value_error_share": error, "action_log_density": -fitted.means["actor"]}


def _loss(
    networks: tuple[GaussianActor, CriticEnsemble], batch: Batch, key: PRNGKeyArray
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    del key
    observations, actions, returns = batch
    actor_loss = -jnp.mean(tanh_gaussian_log_density(*networks[0].parameters(observations), actions))
    critic_loss = _ensemble_loss(networks[1], observations, actions, returns)
    return actor_loss + critic_loss, {"actor": actor_loss, "critics": critic_loss}


@jax.custom_vjp
def _ensemble_loss(
    critics: CriticEnsemble,
    observations: Float[Array, "rows obs_dim"],
    actions: Float[Array, "rows act_dim"],
    returns: Float[Array, " rows"],
) -> Float[Array, ""]:
    """L_Q; its gradient, in the critics alone, is that of `ensemble_td_gradient`: member by member, with the value."""
    return ensemble_td_gradient(critics, observations, actions, returns)[1]


def _forward(critics: CriticEnsemble, *batch: Array) -> tuple[Float[Array, ""], Any]:
    gradient, loss, _ = ensemble_td_gradient(critics, *batch)
    return loss, (gradient, batch)


def _backward(residuals: Any, slope: Float[Array, ""]) -> Any:
    gradient, batch = residuals
    return jax.tree.map(lambda leaf: slope * leaf, gradient), *map(jnp.zeros_like, batch)


_ensemble_loss.defvjp(_forward, _backward)
