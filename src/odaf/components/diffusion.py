"""Denoising diffusion of actions given states (Ho et al. 2020): a model of log behaviour that may have many modes.

    b_k    = min( 0.999, 1 - h((k + 1) / K) / h(k / K) ),  h(u) = cos^2( (u + 0.008) / 1.008 pi / 2 ),  k = 0 .. K - 1
    A_k    = prod_{j <= k} (1 - b_j),  A_{-1} = 1
    L      = mean_{B, dims} ( eps_theta( sqrt(A_k) a + sqrt(1 - A_k) eps, s, k ) - eps )^2,  k uniform, eps ~ N(0, 1)
    a^     = clip( ( a_k - sqrt(1 - A_k) eps_theta(a_k, s, k) ) / sqrt(A_k), -1, 1 )
    a_{k-1} = sqrt(A_{k-1}) b_k / (1 - A_k) a^ + sqrt(1 - b_k) (1 - A_{k-1}) / (1 - A_k) a_k
              + sqrt( b_k (1 - A_{k-1}) / (1 - A_k) ) eps

The schedule is the squared cosine of Nichol & Dhariwal (2021). Sampling begins with a_{K-1} ~ N(0, 1) and ends with the
a^ of k = 0, since nothing is left of a_0 and of the noise there; so what is sampled lies in [-1, 1].
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from odaf.components.networks import MLP, init_mlp

EMBEDDING = 32  # numbers that tell the network which step it is at
LARGEST_BETA = 0.999
SHIFT = 0.008


class Schedule(NamedTuple):
    """What a step of denoising is made of, each float64 [steps]."""

    kept: np.ndarray  # A_k: share of the action's variance
    estimate_weight: np.ndarray  # of a^ in the mean of the next action
    action_weight: np.ndarray  # of a_k in it
    std: np.ndarray  # of the noise that is added to it


def squared_cosine(steps: int) -> Schedule:
    """The schedule of `steps` steps."""
    share = np.cos((np.arange(steps + 1) / steps + SHIFT) / (1.0 + SHIFT) * math.pi / 2.0) ** 2
    beta = np.minimum(1.0 - share[1:] / share[:-1], LARGEST_BETA)
    kept = np.cumprod(1.0 - beta)
    before = np.append(1.0, kept[:-1])
    return Schedule(
        kept,
        np.sqrt(before) * beta / (1.0 - kept),
        np.sqrt(1.0 - beta) * (1.0 - before) / (1.0 - kept),
        np.sqrt(beta * (1.0 - before) / (1.0 - kept)),
    )


class ActionDiffusion(eqx.Module):
    """a ~ pi_b(a|s) by denoising."""

    network: MLP  # of a_k, s and an embedding of k to the noise in a_k
    steps: int = eqx.field(static=True)  # K

    def noise_in(
        self,
        noised: Float[Array, "rows act_dim"],
        observations: Float[Array, "rows obs_dim"],
        step: Int[Array, " rows"],
    ) -> Float[Array, "rows act_dim"]:
        """eps_theta(a_k, s, k)."""
        return self.network(jnp.concatenate([noised, observations, _embedded(step, noised.dtype)], axis=-1))

    def misfit(
        self,
        observations: Float[Array, "rows obs_dim"],
        actions: Float[Array, "rows act_dim"],
        step: Int[Array, " rows"],
        noise: Float[Array, "rows act_dim"],
    ) -> Float[Array, " rows"]:
        """The squared error of each row, mean over dimensions; L is its mean."""
        kept = jnp.asarray(squared_cosine(self.steps).kept, actions.dtype)[step][:, None]
        noised = jnp.sqrt(kept) * actions + jnp.sqrt(1.0 - kept) * noise
        return jnp.mean(jnp.square(self.noise_in(noised, observations, step) - noise), axis=-1)

    def draw(self, key: PRNGKeyArray, rows: int, act_dim: int) -> tuple[Int[Array, " rows"], Float[Array, "rows act"]]:
        """A step and noise for each row's `misfit`."""
        key_step, key_noise = jr.split(key)
        return jr.randint(key_step, (rows,), 0, self.steps), jr.normal(key_noise, (rows, act_dim))

    def sample(
        self, observations: Float[Array, "rows obs_dim"], noise: Float[Array, "steps rows act_dim"]
    ) -> Float[Array, "rows act_dim"]:
        """One action in [-1, 1] a row.

        Args:
            observations: s.
            noise: standard normal; the first is where sampling begins, the others are added on the way.
        """
        schedule = squared_cosine(self.steps)
        numbers = [jnp.asarray(part[::-1].copy(), noise.dtype) for part in schedule]  # from the last step to the first
        step = jnp.arange(self.steps)[::-1]
        added = jnp.concatenate([noise[1:], jnp.zeros_like(noise[:1])])

        def denoised(
            noised: Float[Array, "rows act_dim"], of_step: tuple[Array, ...]
        ) -> tuple[Float[Array, "rows act_dim"], None]:
            index, fresh, kept, estimate_weight, action_weight, std = of_step
            found = self.noise_in(noised, observations, jnp.full(noised.shape[:1], index))
            estimate = jnp.clip((noised - jnp.sqrt(1.0 - kept) * found) / jnp.sqrt(kept), -1.0, 1.0)
            return estimate_weight * estimate + action_weight * noised + std * fresh, None

        actions, _ = jax.lax.scan(denoised, noise[0], (step, added, *numbers))
        return jnp.clip(actions, -1.0, 1.0)  # rounding may step over a bound by one unit in the last place


def init_action_diffusion(
    key: PRNGKeyArray, obs_dim: int, act_dim: int, hidden_sizes: tuple[int, ...], steps: int
) -> ActionDiffusion:
    """Draw the network, layer-normalised before each activation, with zero hidden biases."""
    sizes = (act_dim + obs_dim + EMBEDDING, *hidden_sizes, act_dim)
    return ActionDiffusion(init_mlp(key, sizes, norm="layer", activation="silu", hidden_bias=0.0), steps)


def _embedded(step: Int[Array, " rows"], dtype: jnp.dtype) -> Float[Array, "rows embedding"]:
    """Sines and cosines of the step, of wavelengths from 2 pi to 10,000 times that."""
    half = EMBEDDING // 2
    frequencies = np.exp(-math.log(10_000.0) * np.arange(half) / (half - 1))
    angles = step.astype(dtype)[:, None] * jnp.asarray(frequencies, dtype)[None, :]
    return jnp.concatenate([jnp.sin(angles), jnp.cos(angles)], axis=-1)
