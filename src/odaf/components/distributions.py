"""The tanh-squashed diagonal Gaussian of soft actor-critic, and the plain one."""

import math

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

LOG_TWO_PI = math.log(2.0 * math.pi)
SQUASH_EPSILON = 1e-6


def gaussian_log_density(
    mean: Float[Array, "*rows act_dim"],
    log_std: Float[Array, "*rows act_dim"],
    action: Float[Array, "*rows act_dim"],
    own: Bool[Array, " act_dim"] | None = None,
) -> Float[Array, "*rows"]:
    """log N(a; mean, std^2) of a diagonal Gaussian that is not squashed, in nats.

    Summed over action dimensions, or over those that are `own` (`odaf.data.padding`).
    """
    noise = (action - mean) * jnp.exp(-log_std)
    return _sum_of_own(-0.5 * (jnp.square(noise) + LOG_TWO_PI) - log_std, own)


def tanh_gaussian_log_density(
    mean: Float[Array, "*rows act_dim"], log_std: Float[Array, "*rows act_dim"], action: Float[Array, "*rows act_dim"]
) -> Float[Array, "*rows"]:
    """log pi(a|s) of a given action inside (-1, 1), in nats; with the same floor as `sample_tanh_gaussian`."""
    noise = (jnp.arctanh(action) - mean) * jnp.exp(-log_std)
    log_density = -0.5 * (jnp.square(noise) + LOG_TWO_PI) - log_std
    correction = jnp.log(1.0 - jnp.square(action) + SQUASH_EPSILON)
    return jnp.sum(log_density - correction, axis=-1)


def exact_tanh_gaussian_log_density(
    mean: Float[Array, "*rows act_dim"], log_std: Float[Array, "*rows act_dim"], action: Float[Array, "*rows act_dim"]
) -> Float[Array, "*rows"]:
    """log pi(a|s) of a given action in [-1, 1], in nats, without a floor: what weights of off-policy estimates need.

    log(1 - tanh(u)^2) = 2 (log 2 - |u| - log(1 + exp(-2 |u|))) holds its digits up to the bounds. An action on a
    bound, where the density is 0 and any logged action is a rounded one, counts as the nearest number inside.
    """
    inside = 1.0 - jnp.finfo(action.dtype).epsneg
    pre_tanh = jnp.arctanh(jnp.clip(action, -inside, inside))
    noise = (pre_tanh - mean) * jnp.exp(-log_std)
    return jnp.sum(-0.5 * (jnp.square(noise) + LOG_TWO_PI) - log_std - _log_squash_slope(pre_tanh), axis=-1)


def exact_sample_tanh_gaussian(
    mean: Float[Array, "*rows act_dim"],
    log_std: Float[Array, "*rows act_dim"],
    noise: Float[Array, "*rows act_dim"],
    own: Bool[Array, " act_dim"] | None = None,
) -> tuple[Float[Array, "*rows act_dim"], Float[Array, "*rows"]]:
    """As `sample_tanh_gaussian`, with the log-density's digits up to the bounds instead of a floor."""
    pre_tanh = mean + jnp.exp(log_std) * noise
    log_density = -0.5 * (jnp.square(noise) + LOG_TWO_PI) - log_std - _log_squash_slope(pre_tanh)
    return jnp.tanh(pre_tanh), _sum_of_own(log_density, own)


def _log_squash_slope(pre_tanh: Float[Array, "*rows act_dim"]) -> Float[Array, "*rows act_dim"]:
    size = jnp.abs(pre_tanh)
    return 2.0 * (math.log(2.0) - size - jnp.log1p(jnp.exp(-2.0 * size)))


def sample_tanh_gaussian(
    mean: Float[Array, "*rows act_dim"],
    log_std: Float[Array, "*rows act_dim"],
    noise: Float[Array, "*rows act_dim"],
    own: Bool[Array, " act_dim"] | None = None,
) -> tuple[Float[Array, "*rows act_dim"], Float[Array, "*rows"]]:
    """Re-parameterised action tanh(mean + std * noise) and its log-density.

    Args:
        mean: mean before squashing.
        log_std: log standard deviation before squashing, already clipped.
        noise: standard normal draws; gradients pass to mean and log_std.
        own: the dimensions that log pi(a|s) is of, where actions are padded; None takes all.

    Returns:
        Actions in (-1, 1) and log pi(a|s), summed over action dimensions, in nats.

    Source:
        Haarnoja et al. 2018, appendix C. The 1e-6 inside the logarithm floors the correction of a saturated action at
        about -13.8 a dimension, as in the authors' code of EDAC and RORL.
    """
    pre_tanh = mean + jnp.exp(log_std) * noise
    action = jnp.tanh(pre_tanh)
    log_density = -0.5 * (jnp.square(noise) + LOG_TWO_PI) - log_std
    correction = jnp.log(1.0 - jnp.square(action) + SQUASH_EPSILON)
    return action, _sum_of_own(log_density - correction, own)


def _sum_of_own(terms: Float[Array, "*rows act_dim"], own: Bool[Array, " act_dim"] | None) -> Float[Array, "*rows"]:
    return jnp.sum(terms if own is None else jnp.where(own, terms, 0.0), axis=-1)


def gaussian_divergence(
    mean: Float[Array, "*rows act_dim"],
    log_std: Float[Array, "*rows act_dim"],
    other_mean: Float[Array, "*rows act_dim"],
    other_log_std: Float[Array, "*rows act_dim"],
) -> Float[Array, "*rows act_dim"]:
    """KL( N(mean, std^2) || N(other_mean, other_std^2) ) of every dimension, in nats; not summed."""
    gap = log_std - other_log_std
    distance = (mean - other_mean) * jnp.exp(-other_log_std)
    return 0.5 * (jnp.expm1(2.0 * gap) + jnp.square(distance)) - gap


def symmetric_gaussian_divergence(
    mean: Float[Array, "*rows act_dim"],
    log_std: Float[Array, "*rows act_dim"],
    other_mean: Float[Array, "*rows act_dim"],
    other_log_std: Float[Array, "*rows act_dim"],
) -> Float[Array, "*rows act_dim"]:
    """KL in one direction plus KL in the other, of every dimension, in nats; not summed.

    The logarithms cancel, which leaves 2 sinh(l - l')^2 + (m - m')^2 (1 / std^2 + 1 / std'^2) / 2: exact for close
    Gaussians too, where a sum of two divergences would be rounding errors.
    """
    precisions = jnp.exp(-2.0 * log_std) + jnp.exp(-2.0 * other_log_std)
    return 2.0 * jnp.square(jnp.sinh(log_std - other_log_std)) + 0.5 * jnp.square(mean - other_mean) * precisions
