"""An average of the actor over its last updates, beside the learner's own state.

    m_n = m_{n-1} + ( theta_n - m_{n-1} ) / min(n, H),    n = 1, 2, ...

theta_n are the actor's parameters after n updates and H is `averaged_updates`: the plain mean until update H, from then
on weights that fall by a factor e within H updates. The learner never sees m; it is what is deployed.

A value learner's actor climbs the values of the moment, and swings with them; its average does not (Polyak and Juditsky
1992 for stochastic approximation).
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, PRNGKeyArray, PyTree

from odaf.algorithms.base import Algorithm, LearnerState, Metrics
from odaf.components.policies import Actor
from odaf.components.targets import copy_of
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.errors import ConfigError


class AveragedState(LearnerState):
    """A learner's state, and the average of its actors so far."""

    step: Int[Array, ""]
    learner: LearnerState
    average: Actor


def require_horizon(algorithm: Algorithm) -> None:
    """Refuses a horizon below 0.

    Raises:
        ConfigError: it is.
    """
    if algorithm.averaged_updates < 0:
        raise ConfigError(
            f"averaged_updates={algorithm.averaged_updates}: must be a number of updates, or 0 for the actor as it is"
        )


def begin(algorithm: Algorithm, key: PRNGKeyArray, spec: Spec, models: PyTree) -> LearnerState:
    """The state before the first update: the learner's own, with its first actor as the average if one is asked for."""
    state = algorithm.init(key, spec, models)
    if not algorithm.averaged_updates:
        return state
    return AveragedState(state.step, state, copy_of(algorithm.actor(state)))


def advanced(
    algorithm: Algorithm, state: LearnerState, batch: Transitions, key: PRNGKeyArray
) -> tuple[LearnerState, Metrics]:
    """`algorithm.update`, after which the average moves."""
    if not isinstance(state, AveragedState):
        return algorithm.update(state, batch, key)
    learner, metrics = algorithm.update(state.learner, batch, key)
    share = 1.0 / jnp.minimum(learner.step, algorithm.averaged_updates).astype(jnp.float32)
    average = jax.tree.map(
        lambda mean, new: mean + share.astype(mean.dtype) * (new - mean) if eqx.is_inexact_array(mean) else new,
        state.average,
        algorithm.actor(learner),
    )
    return AveragedState(learner.step, learner, average), metrics


def with_learner(state: LearnerState, learner: LearnerState) -> LearnerState:
    """`state` with another one of the learner's own in it."""
    return AveragedState(learner.step, learner, state.average) if isinstance(state, AveragedState) else learner


def at_step(state: LearnerState, step: Int[Array, ""]) -> LearnerState:
    """`state` with this array as its count of updates, which it equals.

    All lanes of a program have made as many. If they share the array, what a learner does every n updates alone is
    branched to; with a count for each lane it would be computed in every update and thrown away.
    """
    learner = learner_state(state)
    return with_learner(state, dataclasses.replace(learner, step=step.astype(learner.step.dtype)))


def learner_state(state: Any) -> Any:
    """The learner's own state."""
    return state.learner if isinstance(state, AveragedState) else state


def deployed_actor(algorithm: Algorithm, state: LearnerState) -> Actor:
    """What the trained policy is: the average where there is one, else the actor."""
    return state.average if isinstance(state, AveragedState) else algorithm.actor(state)
