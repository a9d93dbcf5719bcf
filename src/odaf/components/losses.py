"""Losses that several learners share. Each says what is summed, what is averaged, and who receives gradients."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def ensemble_td_loss(values: Float[Array, "critics rows"], target: Float[Array, " rows"]) -> Float[Array, ""]:
    """sum_k mean_B (Q_k - y)^2, no factor one half; y receives no gradient.

    Summing over members makes each member's effective learning rate independent of the ensemble's size.
    """
    errors = values - jax.lax.stop_gradient(target)[None, :]
    return jnp.sum(jnp.mean(jnp.square(errors), axis=1))


def soft_actor_loss(
    log_density: Float[Array, " rows"], value: Float[Array, " rows"], temperature: Float[Array, ""]
) -> Float[Array, ""]:
    """mean_B (alpha log pi(a|s) - Q(s, a)); the temperature alpha is a constant here."""
    return jnp.mean(jax.lax.stop_gradient(temperature) * log_density - value)


def temperature_loss(
    log_temperature: Float[Array, ""], log_density: Float[Array, " rows"], target_entropy: float
) -> Float[Array, ""]:
    """-mean_B log(alpha) (log pi + H): entropy below the target H raises alpha. Only log(alpha) gets a gradient."""
    return -jnp.mean(log_temperature * jax.lax.stop_gradient(log_density + target_entropy))
