"""A guard as operations of a policy's program: the score of `odaf.deployment.score`, the alarm, and the reaction.

The status of a step with an alarm is 4; its action is what the reaction gives. With "stop" it is 5, without an action,
from there on. The output `guard` holds each part of the score beside its limit: 1 is the limit.

Carries beside those of the policy: `guard_state`, the normalised observation of the step before, NaN where it is not
known, as after a reading that was refused: the next step is judged without surprise. `guard_stopped`, 1 once it has
stopped. The action of the step before is the policy's `actions_before`, so that a guard is told what was played.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from odaf.components.critics import ROOT_EPSILON, CriticEnsemble
from odaf.components.dynamics import DynamicsModel
from odaf.components.dynamics.cvae import CVAEDynamics
from odaf.components.dynamics.deterministic import DeterministicDynamics
from odaf.components.dynamics.gaussian_ensemble import GaussianEnsembleDynamics
from odaf.components.policies import DeterministicActor
from odaf.deployment.actors import described
from odaf.deployment.guard import GuardedPolicy
from odaf.deployment.networks import mlp
from odaf.deployment.odaf_policy import ALARM, STOPPED
from odaf.deployment.policies import Described, describe, unscaled
from odaf.deployment.program import DRAWS, STACK, WIDTH, Builder, Program, Value
from odaf.deployment.score import PARTS
from odaf.errors import ConfigError


def guarded_program(guarded: GuardedPolicy) -> Program:
    """The program of a policy with its guard.

    Raises:
        ConfigError: as `odaf.deployment.policies.describe`, or nobody said how dynamics or clones of this class act.
    """
    found = describe(guarded.policy)
    build, policy = found.builder, guarded.policy
    one = build.constant("one", 1.0)
    before = found.actions_before
    if before is None:
        before = build.remembered("actions_before", [np.nan] * policy.act_dim)
        found = replace(found, actions_before=before)
    last = build("slice", before, first=0, last=policy.act_dim)
    state_before = build.remembered("guard_state", [np.nan] * policy.obs_dim)

    parts = _parts(guarded, found, state_before, last)
    limit = np.asarray(guarded.score.levels, np.float64) * guarded.calibration.threshold
    beside = build("divide", parts, build.parameter("guard/limits", limit))
    score = build("largest", beside, axis=WIDTH)
    sound = build("smallest", build("finite", beside), axis=WIDTH)
    alarm = build("select", sound, build("less", one, score), one)
    known = found.readable if found.known is None else build("multiply", found.readable, found.known)

    action, verdict = _reacted(guarded, found, alarm, last), None
    level = build.constant("guard/alarm", float(ALARM))
    if guarded.reaction == "stop":
        stopped = build.remembered("guard_stopped", [0.0])
        now = build("maximum", stopped, build("multiply", alarm, known))
        verdict = build("multiply", now, build.constant("guard/stopped", float(STOPPED)))
        halted = build("maximum", now, build("subtract", one, found.readable))  # a missing reading is an alarm too
        build.remember(stopped, halted)
    else:
        verdict = build("multiply", alarm, level)
    nowhere = build.constant("guard/nowhere", [np.nan] * policy.obs_dim)
    build.remember(state_before, build("select", known, found.normalised, nowhere))
    return replace(found, action=action).program(verdict, {"guard": (beside, PARTS)})


def _parts(guarded: GuardedPolicy, found: Described, state_before: Value, last: Value) -> Value:
    """[1, 1, parts]."""
    build, policy, score = found.builder, guarded.policy, guarded.score
    states = found.normalised
    actions, actions_before = (_scaled(build, guarded, each) for each in (found.action, last))

    off = build("absolute", build("subtract", found.seen, build.parameter("guard/centre", score.centre)))
    beyond = build("largest", build("divide", off, build.parameter("guard/half_width", score.half_width)), axis=WIDTH)

    whitening = build.parameter("guard/whitening", score.whitening)
    place = build("affine", build("concatenate", states, actions), whitening)
    gaps = build("subtract", place, build.parameter("guard/points", np.asarray(score.points)[None]))
    distance = build("sqrt", build("smallest", _squares(build, gaps), axis=DRAWS))

    predict = _OUTCOMES.get(type(score.outcome))
    if predict is None:
        raise ConfigError(
            f"{type(score.outcome).__name__}: no description of how it predicts; guard with dynamics of "
            f"{', '.join(sorted(kind.__name__ for kind in _OUTCOMES))}"
        )
    outcome = _outcome(build, score.outcome, predict, states, actions)
    values = _values(build, score.critics, outcome, described(build, policy.actor, outcome))
    centred = build("subtract", values, build("mean", values, axis=STACK))
    variance = build("mean", build("multiply", centred, centred), axis=STACK)
    parted = build("sqrt", build("add", variance, build.constant("guard/epsilon", ROOT_EPSILON)))

    told = build("smallest", build("finite", build("concatenate", state_before, actions_before)), axis=WIDTH)
    expected = _outcome(build, score.outcome, predict, state_before, actions_before)
    error = build("affine", build("subtract", states, expected), build.parameter("guard/errors", score.error_whitening))
    surprise = build("sqrt", _squares(build, error))
    surprise = build("select", told, surprise, build.constant("guard/none", 0.0))
    return build("concatenate", beyond, distance, parted, surprise)


def _reacted(guarded: GuardedPolicy, found: Described, alarm: Value, last: Value) -> Value:
    build = found.builder
    if guarded.reaction == "hold":
        there = build("smallest", build("finite", last), axis=WIDTH)
        return build("select", build("multiply", alarm, there), last, found.action)
    if guarded.reaction == "clone":
        clone = guarded.clone
        if type(clone) is not DeterministicActor:
            raise ConfigError(f"{type(clone).__name__}: no description of how such a clone acts; make the guard again")
        imitated = build("tanh", mlp(build, clone.network, "clone/network", found.normalised))
        return build("select", alarm, unscaled(build, guarded.policy, imitated), found.action)
    return found.action


def _scaled(build: Builder, guarded: GuardedPolicy, action: Value) -> Value:
    """In [-1, 1]."""
    low, high = (np.asarray(bound, np.float64) for bound in (guarded.policy.action_low, guarded.policy.action_high))
    centred = build("subtract", action, build.constant("actions/centre", (high + low) / 2))
    return build("divide", centred, build.constant("actions/half", (high - low) / 2))


def _squares(build: Builder, value: Value) -> Value:
    return build("sum", build("multiply", value, value), axis=WIDTH)


def _values(build: Builder, critics: CriticEnsemble, states: Value, actions: Value) -> Value:
    """[critics, 1, 1]."""
    values = mlp(build, critics.networks, "guard/critics", states, actions)
    if critics.priors is None:
        return values
    priors = mlp(build, critics.priors.networks, "guard/priors", states, actions)
    return build("add", values, build("multiply", priors, build.constant("guard/prior_scale", critics.priors.scale)))


def _outcome(
    build: Builder, model: Any, predict: Callable[[Builder, Any, Value, Value], Value], states: Value, actions: Value
) -> Value:
    """f(z, a)."""
    output = predict(build, model, states, actions)
    moved = build("multiply", output, build.parameter("guard/outcome/scale", model.scale))
    moved = build("add", moved, build.parameter("guard/outcome/shift", model.shift))
    return build("add", states, moved) if model.residual else moved


def _deterministic(build: Builder, model: DeterministicDynamics, states: Value, actions: Value) -> Value:
    return mlp(build, model.network, "guard/outcome/network", states, actions)


def _ensemble(build: Builder, model: GaussianEnsembleDynamics, states: Value, actions: Value) -> Value:
    outputs = mlp(build, model.network, "guard/outcome/network", states, actions, outputs=model.shift.shape[0])
    return build("mean", outputs, axis=STACK)


def _cvae(build: Builder, model: CVAEDynamics, states: Value, actions: Value) -> Value:
    """Of the central z: the prior's, or the encoder's mean."""
    cvae = model.cvae
    if cvae.sees_target:
        latent = build.constant("guard/outcome/latent", np.zeros(cvae.latent_dim))
    else:
        latent = mlp(build, cvae.encoder, "guard/outcome/encoder", states, actions, outputs=cvae.latent_dim)
    return mlp(build, cvae.decoder, "guard/outcome/decoder", states, actions, latent)


_OUTCOMES: dict[type[DynamicsModel], Callable[[Builder, Any, Value, Value], Value]] = {
    CVAEDynamics: _cvae,
    DeterministicDynamics: _deterministic,
    GaussianEnsembleDynamics: _ensemble,
}
