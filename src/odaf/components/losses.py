"""Losses that several learners share. Each says what is summed, what is averaged, and who receives gradients."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from odaf.components.critics import CriticEnsemble, over_members
from odaf.components.numbers import Number


def td_loss(values: Float[Array, " rows"], target: Float[Array, " rows"]) -> Float[Array, ""]:
    """mean_B (Q_k - y)^2 of one member, no factor one half; y receives no gradient."""
    return jnp.mean(jnp.square(values - jax.lax.stop_gradient(target)))


def ensemble_td_gradient(
    critics: CriticEnsemble,
    observations: Float[Array, "rows obs_dim"],
    actions: Float[Array, "rows act_dim"],
    target: Float[Array, "*critics rows"],
) -> tuple[CriticEnsemble, Float[Array, ""], Float[Array, "critics rows"]]:
    """Gradient, value and predictions of L_Q = sum_k mean_B (Q_k - y)^2, with one y for all members or one each.

    Summing over members makes each member's effective learning rate independent of the ensemble's size. It also means
    that members do not interact, so each one's gradient is taken on its own, forward and backward in one go.
    """
    inputs = jnp.concatenate([observations, actions], axis=-1)

    def member(critic: CriticEnsemble, y: Float[Array, " rows"]) -> tuple[CriticEnsemble, Array, Array]:
        def loss(critic: CriticEnsemble) -> tuple[Float[Array, ""], Float[Array, " rows"]]:
            values = critic.value(inputs)
            return td_loss(values, y), values

        (value, predictions), gradient = jax.value_and_grad(loss, has_aux=True)(critic)
        return gradient, value, predictions

    if target.ndim == 1:
        gradients, values, predictions = over_members(lambda critic: member(critic, target), critics)
    else:
        gradients, values, predictions = over_members(lambda pair: member(*pair), (critics, target))
    return gradients, jnp.sum(values), predictions


def squared_distance(
    actions: Float[Array, "rows act_dim"], logged: Float[Array, "rows act_dim"]
) -> Float[Array, " rows"]:
    """||a - a_logged||^2 of each row, summed over action dimensions; gradients flow through both."""
    return jnp.sum(jnp.square(actions - logged), axis=-1)


def expectile_loss(differences: Float[Array, " rows"], expectile: Number) -> Float[Array, ""]:
    """mean_B |expectile - 1(u < 0)| u^2 of differences u = target - prediction.

    The minimiser is the expectile of the targets: their mean at 0.5, towards their largest as it nears 1.
    """
    weights = jnp.where(differences < 0.0, 1.0 - expectile, expectile)
    return jnp.mean(weights * jnp.square(differences))


def soft_actor_loss(
    log_density: Float[Array, " rows"], value: Float[Array, " rows"], temperature: Float[Array, ""]
) -> Float[Array, ""]:
    """mean_B (alpha log pi(a|s) - Q(s, a)); the temperature alpha is a constant here."""
    return jnp.mean(jax.lax.stop_gradient(temperature) * log_density - value)


def temperature_loss(
    log_temperature: Float[Array, ""], log_density: Float[Array, " rows"], target_entropy: float | Float[Array, ""]
) -> Float[Array, ""]:
    """-mean_B log(alpha) (log pi + H): entropy below the target H raises alpha. Only log(alpha) gets a gradient."""
    return -jnp.mean(log_temperature * jax.lax.stop_gradient(log_density + target_entropy))
