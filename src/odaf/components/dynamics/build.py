"""A dynamics model of the configured kind, before training."""

import jax.numpy as jnp
from jaxtyping import PRNGKeyArray

from odaf.components.cvae import init_cvae
from odaf.components.dynamics.base import DynamicsConfig, DynamicsModel
from odaf.components.dynamics.cvae import CVAEDynamics
from odaf.components.dynamics.deterministic import DeterministicDynamics
from odaf.components.dynamics.gaussian_ensemble import (
    LOG_VARIANCE_MAX,
    LOG_VARIANCE_MIN,
    GaussianEnsembleDynamics,
)
from odaf.components.networks import init_mlp


def untrained(
    config: DynamicsConfig, key: PRNGKeyArray, obs_dim: int, act_dim: int, members: int | None = None
) -> DynamicsModel:
    """Draw the networks of a model.

    Args:
        config: kind and sizes.
        key: random key.
        obs_dim: state dimension.
        act_dim: action dimension.
        members: ensemble size; None gives the size that is kept after training (`config.elites`).
    """
    shift, scale = jnp.zeros(obs_dim), jnp.ones(obs_dim)
    hidden, inputs = config.hidden_sizes, obs_dim + act_dim
    if config.kind == "deterministic":
        network = init_mlp(key, (inputs, *hidden, obs_dim))
        return DeterministicDynamics(network=network, shift=shift, scale=scale, residual=config.residual)
    if config.kind == "ensemble":
        network = init_mlp(
            key,
            (inputs, *hidden, 2 * obs_dim),
            members=config.elites if members is None else members,
            activation="silu",
            hidden_bias=0.0,
        )
        return GaussianEnsembleDynamics(
            network=network,
            log_variance_max=jnp.full(obs_dim, LOG_VARIANCE_MAX),
            log_variance_min=jnp.full(obs_dim, LOG_VARIANCE_MIN),
            shift=shift,
            scale=scale,
            residual=config.residual,
        )
    cvae = init_cvae(
        key,
        condition_dim=inputs,
        target_dim=obs_dim,
        output_dim=obs_dim,
        latent_dim=config.latent_dim,
        encoder_sizes=(*hidden, hidden[-1]),
        decoder_sizes=hidden,
        sees_target=config.encoder == "transition",
    )
    return CVAEDynamics(cvae=cvae, shift=shift, scale=scale, residual=config.residual)
