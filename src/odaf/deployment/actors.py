"""How each kind of actor acts without a key, as operations of a program: a function a class.

An actor of a package of its own is exported once its class stands in `DESCRIPTIONS`. Its function takes the builder,
the actor and the normalised observation, and returns the action in [-1, 1]; what the actor carries is read with
`Builder.remembered` and handed on with `Builder.remember`. A step that is refused leaves it as it was. The function of
an actor that `takes_rewards` is also given the reward of the action before.
"""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from odaf.components.cvae import PRIOR_CLIP
from odaf.components.policies import (
    LOG_STD_MAX,
    LOG_STD_MIN,
    Actor,
    DeterministicActor,
    ExactGaussianActor,
    GaussianActor,
    NarrowGaussianActor,
    UnsquashedGaussianActor,
)
from odaf.components.ranked_actors import PerturbedActor, RankedGaussianActor
from odaf.components.return_conditioned import ReturnConditionedActor
from odaf.deployment.networks import mlp
from odaf.deployment.program import Builder, Value
from odaf.errors import ConfigError

Description = Callable[..., Value]


def described(builder: Builder, actor: Actor, observation: Value, *rewards: Value) -> Value:
    """The actor's deterministic action in [-1, 1].

    Args:
        builder: of the program.
        actor: to describe.
        observation: normalised.
        *rewards: what the action before has earned, where the actor takes rewards; 0 in the first step.

    Raises:
        ConfigError: nobody said how actors of this class act, or its parameters are not finite.
    """
    describe = DESCRIPTIONS.get(type(actor))
    if describe is None:
        known = ", ".join(sorted(kind.__name__ for kind in DESCRIPTIONS))
        memory = " and what it remembers" if jax.tree.leaves(actor.begin(1)) else ""
        raise ConfigError(
            f"{type(actor).__name__}: no description of how it acts{memory}; register one as "
            f"odaf.deployment.actors.DESCRIPTIONS[{type(actor).__name__}]. There are {known}"
        )
    return describe(builder, actor, observation, *rewards)


def _squashed_mean(builder: Builder, actor: Any, observation: Value) -> Value:
    """tanh of the first half of the network's outputs; the other half is the log standard deviation."""
    half = actor.network.weights[-1].shape[-1] // 2
    return builder("tanh", mlp(builder, actor.network, "actor/network", observation, outputs=half))


def _squashed(builder: Builder, actor: Any, observation: Value) -> Value:
    return builder("tanh", mlp(builder, actor.network, "actor/network", observation))


def _best_of_gaussian(builder: Builder, actor: RankedGaussianActor, observation: Value) -> Value:
    outputs = mlp(builder, actor.proposals.network, "actor/proposals", observation)
    half = outputs.width // 2
    mean, log_std = builder("slice", outputs, first=0, last=half), builder("slice", outputs, first=half, last=2 * half)
    std = builder("exp", clipped(builder, log_std, "actor/log_std", LOG_STD_MIN, LOG_STD_MAX))
    noise = builder.parameter("actor/noise", actor.noise)
    candidates = builder("tanh", builder("add", mean, builder("multiply", std, noise)))
    return _best(builder, actor.critic, observation, candidates)


def _best_of_decoded(builder: Builder, actor: PerturbedActor, observation: Value) -> Value:
    noise = np.clip(np.asarray(actor.noise), -PRIOR_CLIP, PRIOR_CLIP)
    decoded = mlp(builder, actor.decoder, "actor/decoder", observation, builder.parameter("actor/noise", noise))
    candidates = builder("tanh", decoded)
    change = builder("tanh", mlp(builder, actor.perturbation, "actor/perturbation", observation, candidates))
    moved = builder("add", candidates, builder("multiply", change, builder.parameter("actor/reach", actor.reach)))
    return _best(builder, actor.critic, observation, clipped(builder, moved, "actor/bound", -1.0, 1.0))


def _return_conditioned(builder: Builder, actor: ReturnConditionedActor, observation: Value, reward: Value) -> Value:
    before = builder.remembered("return_to_go", [float(actor.start)])
    wanted = builder("subtract", before, reward)
    builder.remember(before, wanted)
    wanted = builder("subtract", wanted, builder.parameter("actor/mean", actor.mean))
    wanted = builder("divide", wanted, builder.parameter("actor/std", actor.std))
    return clipped(builder, mlp(builder, actor.network, "actor/network", observation, wanted), "actor/bound", -1.0, 1.0)


def _best(builder: Builder, critic: Any, observation: Value, candidates: Value) -> Value:
    return builder("best", mlp(builder, critic, "actor/critic", observation, candidates), candidates)


def clipped(builder: Builder, value: Value, path: str, low: Any, high: Any) -> Value:
    """The value cut to bounds."""
    above = builder("maximum", value, builder.constant(f"{path}/low", low))
    return builder("minimum", above, builder.constant(f"{path}/high", high))


DESCRIPTIONS: dict[type[Actor], Description] = {
    DeterministicActor: _squashed,
    ExactGaussianActor: _squashed_mean,
    GaussianActor: _squashed_mean,
    NarrowGaussianActor: _squashed_mean,
    PerturbedActor: _best_of_decoded,
    RankedGaussianActor: _best_of_gaussian,
    ReturnConditionedActor: _return_conditioned,
    UnsquashedGaussianActor: _squashed,
}
"""By the actor's class, not those derived from it."""
