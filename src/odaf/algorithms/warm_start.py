"""A start from the log: critics fitted to the returns that followed, the actor to the actions that were taken.

    L_Q  = sum_k mean_B ( Q_k(s, a) - G )^2,      G = discounted sum of the rewards from this row to its episode's end
    L_pi = - mean_B log pi(a|s)

Fresh critics climb to the size of the returns at the pace of the optimiser, and the Bellman targets carry values back
at the pace of the slow copies. Both clocks are skipped by fitting the logged returns first. These are the values of
whoever acted in the log; training takes them from there. Either side can be fitted alone.
"""

import functools
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from odaf.components.critics import CriticEnsemble
from odaf.components.distributions import tanh_gaussian_log_density
from odaf.components.fitting import Batch, Progress, fit
from odaf.components.losses import ensemble_td_gradient
from odaf.components.policies import GaussianActor
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser, scale_actions

STRETCH = 500
LARGEST_ACTION = 0.999  # logged actions are cut to this: the density of +-1 itself is infinite

SomeActor = TypeVar("SomeActor", GaussianActor, None)
SomeCritics = TypeVar("SomeCritics", CriticEnsemble, None)


def fit_to_log(
    actor: SomeActor,
    critics: SomeCritics,
    dataset: Dataset,
    normaliser: Normaliser,
    returns: Float[np.ndarray, " rows"] | None,
    key: PRNGKeyArray,
    *,
    steps: int,
    batch_size: int,
    learning_rate: float,
    progress: Progress,
    rows: Int[np.ndarray, " drawn"] | None = None,
) -> tuple[SomeActor, SomeCritics, dict[str, float]]:
    """Adam on both losses, with fresh moments that are thrown away afterwards.

    Args:
        actor: where the actor starts; None fits none.
        critics: where the critics start; None fits none.
        dataset: the log.
        normaliser: its observation scaling.
        returns: what the critics are fitted to, in their own units; None without critics.
        key: random key; chooses the batches.
        steps: updates.
        batch_size: rows an update.
        learning_rate: step size.
        progress: called with (steps done, steps in all).
        rows: of the log, that batches are drawn from, some more than once; None takes every row once.

    Returns:
        The fitted networks, and the losses of the last stretch: mean squared error of the critics over rows and members
        as a share of the returns' variance ("value_error_share"), and the actor's log-density in nats
        ("action_log_density").
    """
    scaled = np.clip(
        scale_actions(dataset.actions, dataset.action_low, dataset.action_high), -LARGEST_ACTION, LARGEST_ACTION
    )
    columns = [normaliser.normalise(dataset.observations), scaled, *([] if returns is None else [returns])]
    if rows is not None:
        columns = [column[rows] for column in columns]
    fitted = fit(
        (actor, critics),
        _loss,
        tuple(map(jnp.asarray, columns)),
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
    findings = {}
    if critics is not None and returns is not None:
        members = critics.networks.biases[0].shape[0]
        findings["value_error_share"] = fitted.means["critics"] / members / max(float(np.var(columns[-1])), 1e-12)
    if actor is not None:
        findings["action_log_density"] = -fitted.means["actor"]
    return actor, critics, findings


def _loss(
    networks: tuple[GaussianActor | None, CriticEnsemble | None], batch: Batch, key: PRNGKeyArray
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    del key
    (actor, critics), (observations, actions, *returns) = networks, batch
    losses = {}
    if actor is not None:
        losses["actor"] = -jnp.mean(tanh_gaussian_log_density(*actor.parameters(observations), actions))
    if critics is not None:
        losses["critics"] = _ensemble_loss(critics, observations, actions, *returns)
    return functools.reduce(jnp.add, losses.values()), losses


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
