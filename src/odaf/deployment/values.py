"""Critics of a policy, fitted to a log: what a guard takes the disagreement of where the learner has no critics.

    y_k = r + gamma (1 - d) Q'_k(s', mu(s')),     L = sum_k mean_B ( Q_k(s, a) - y_k )^2

mu is the policy, Q' a slow copy, rewards are shifted to mean 0 and scaled to spread 1, and y is cut to what such
rewards allow. Every member has first weights and rows, drawn with replacement, of its own, so that members agree where
the log says what an action is worth and part where it does not (Osband et al. 2016).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.critics import CriticEnsemble, init_critics
from odaf.components.fitting import Batch, Progress, bootstrap_rows, fit, of_rows
from odaf.components.networks import MLP
from odaf.components.policies import Actor
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser, scale_actions

SLOW_RATE = 0.01


class _Critics(eqx.Module):
    networks: MLP
    discount: Float[Array, ""]
    limit: Float[Array, ""]  # of |y|


def fit_critics(
    actor: Actor,
    dataset: Dataset,
    normaliser: Normaliser,
    key: PRNGKeyArray,
    *,
    members: int,
    hidden_sizes: tuple[int, ...],
    discount: float,
    steps: int,
    batch_size: int,
    progress: Progress,
) -> CriticEnsemble:
    """Critics of normalised observations and actions in [-1, 1], in spreads of the logged reward.

    Raises:
        DivergenceError: the loss stopped being finite.
    """
    key_init, key_rows, key_fit = jr.split(key, 3)
    rewards = dataset.rewards.astype(np.float64)
    spread = float(rewards.std()) or max(abs(float(rewards.mean())), 1.0)
    scaled = ((rewards - rewards.mean()) / spread).astype(np.float32)
    observations, following = (
        jnp.asarray(normaliser.normalise(column), jnp.float32)
        for column in (dataset.observations, dataset.next_observations)
    )
    actions = jnp.asarray(scale_actions(dataset.actions, dataset.action_low, dataset.action_high), jnp.float32)
    taken = jnp.asarray(of_rows(_modes, actor, (following,)))
    terminated = jnp.asarray(dataset.terminated, jnp.float32)
    networks = init_critics(
        key_init, dataset.obs_dim, dataset.act_dim, hidden_sizes, members, norm="layer", output_bound=None
    )
    limit = float(np.abs(scaled).max()) / (1.0 - discount)
    model = _Critics(networks, jnp.asarray(discount, jnp.float32), jnp.asarray(limit, jnp.float32))
    trainable = eqx.tree_at(
        lambda tree: tree.networks, jax.tree.map(lambda _: False, model), jax.tree.map(lambda _: True, networks)
    )
    fitted = fit(
        model,
        _loss,
        (observations, actions, jnp.asarray(scaled), terminated, following, taken),
        bootstraps=bootstrap_rows(key_rows, members, len(dataset), len(dataset)),
        members=members,
        trainable=trainable,
        slow_rate=SLOW_RATE,
        noisy=False,
        steps=steps,
        batch_size=batch_size,
        learning_rate=3e-4,
        key=key_fit,
        progress=progress,
        what="critics of the guard",
        remedy="check the log for outliers with `odaf data check`",
    )
    return CriticEnsemble(fitted.model.networks)


def _modes(actor: Actor, batch: Batch) -> Float[Array, "rows act_dim"]:
    return actor.mode(batch[0])


def _loss(
    model: _Critics, batch: Batch, key: PRNGKeyArray, slow: _Critics
) -> tuple[Float[Array, ""], dict[str, Float[Array, ""]]]:
    del key
    observations, actions, rewards, terminated, following, taken = batch
    later = slow.networks(jnp.concatenate([following, taken], axis=-1))[..., 0]
    targets = jnp.clip(rewards + model.discount * (1.0 - terminated) * later, -model.limit, model.limit)
    values = model.networks(jnp.concatenate([observations, actions], axis=-1))[..., 0]
    return jnp.sum(jnp.mean(jnp.square(values - jax.lax.stop_gradient(targets)), axis=1)), {}
