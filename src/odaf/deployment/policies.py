"""A policy as a program: readings in, an action in the user's units out, and a number that says whether there is one.

The output `status` is 0 where the action may be taken, 1 where a reading is not a finite number, 2 where earlier steps
of which the observation is made are not known, 3 where the numbers ran over; with a guard, 4 is an alarm, and 5 where
one has stopped it. Where it is neither 0 nor 4 the action is NaN. A refused step (1 or 3) changes nothing that is
remembered, so the next one stands as if it had not been.

Carries: `observations_before` [history x parts], the latest first, where observations hold lags or differences, and
`actions_before` [steps x act_dim], the latest first, where they hold earlier actions or the change of an action is
limited. An unknown number is NaN; the first action of an episode is not limited. An actor with a memory has carries of
its own: `return_to_go`, for one that is asked for a return. Such an actor is told what was earned: `last_reward`, the
last column of `observation`, is the reward of what was done in the step before, and 0 in the first.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from odaf.data.derived import Derivation
from odaf.deployment.actors import clipped, described
from odaf.deployment.odaf_policy import ALARM, NOT_FINITE, NOT_KNOWN, OVERFLOW
from odaf.deployment.program import STATUS, WIDTH, Builder, Program, Value
from odaf.errors import ConfigError
from odaf.training.policy import Policy

OBSERVATION, ACTION = "observation", "action"
REWARD = "last_reward"  # the last column of the observation of a policy whose actor takes rewards


@dataclass(frozen=True)
class Described:
    """A policy's program before its outputs are named: what a guard may look at, and act on.

    Attributes:
        builder: of the program.
        policy: what is described.
        observation: readings in the user's units.
        readable: 1 where every reading is finite, else 0.
        own: the part of the observation that is of this step.
        known: 1 where the earlier steps are known, else 0; None where none are looked at.
        seen: the whole observation, in the user's units.
        normalised: what the actor sees.
        scaled: its action in [-1, 1].
        action: in the user's units, within bounds and limits; rubbish where `readable` or `known` is 0.
        observations_before: carry; None where nothing is remembered.
        actions_before: carry; None where nothing is remembered.
        actor_memory: what the actor remembers, before the step and after it.
    """

    builder: Builder
    policy: Policy
    observation: Value
    readable: Value
    own: Value
    known: Value | None
    seen: Value
    normalised: Value
    scaled: Value
    action: Value
    observations_before: Value | None
    actions_before: Value | None
    actor_memory: tuple[tuple[Value, Value], ...] = ()

    def program(
        self, verdict: Value | None = None, more: Mapping[str, tuple[Value, Sequence[str]]] | None = None
    ) -> Program:
        """Names the outputs, hands on what is remembered, and closes the program.

        Args:
            verdict: the status in a step that has an action; None is 0. `STOPPED` takes the action away.
            more: further outputs by name, with their columns.
        """
        build = self.builder
        one, nothing = build.constant("one", 1.0), build.constant("unknown", math.nan)
        number = {status: build.constant(f"status/{status}", float(status)) for status in range(1, 4)}
        fine = build("subtract", one, one) if verdict is None else verdict
        done = build("smallest", build("finite", self.action), axis=WIDTH)
        status = build("select", done, fine, number[OVERFLOW])
        moves = done
        if self.known is not None:
            status = build("select", self.known, status, number[NOT_KNOWN])
            moves = build("select", self.known, done, one)
        status = build("select", self.readable, status, number[NOT_FINITE])
        moves = build("multiply", self.readable, moves)
        refused = status
        if verdict is not None:
            refused = build(
                "multiply", status, build("absolute", build("subtract", status, build.constant("alarm", ALARM)))
            )
        action = build("select", refused, nothing, self.action)
        for before, latest, of in (
            (self.observations_before, self.own, ""),
            (self.actions_before, action, ACTION),
        ):
            if before is not None:
                kept = before.width - latest.width
                after = build("concatenate", latest, build("slice", before, first=0, last=kept)) if kept else latest
                build.remember(before, build("select", moves, after, before), of)
        for before, after in self.actor_memory:
            build.remember(before, build("select", moves, after, before))
        build.output(ACTION, action, action_names(self.policy), self.policy.action_units)
        for name, (value, columns) in (more or {}).items():
            build.output(name, value, columns)
        build.output(STATUS, status)
        return build.program()


def policy_program(policy: Policy, max_change: Mapping[str, float] | None = None) -> Program:
    """The program of a policy; errors as `describe`."""
    return describe(policy, max_change).program()


def describe(policy: Policy, max_change: Mapping[str, float] | None = None) -> Described:
    """The program of a policy up to its action.

    Args:
        policy: in the user's units.
        max_change: the largest change of an action from one step to the next, by the action's name, in its unit.

    Raises:
        ConfigError: the actor's class has no description, an observation is a formula, or a limit is none.
    """
    build, derivation = Builder(), policy.derivation
    if derivation is not None:
        _refuse_formulas(derivation)
    limits = _limits(policy, max_change or {})
    units = dict(zip(policy.observation_names, policy.observation_units, strict=False))
    names, columns = policy.reading_names, input_columns(policy)
    given = build.input(OBSERVATION, columns, [units.get(name, "") for name in columns])
    readable = build("smallest", build("finite", given), axis=WIDTH)
    observation, rewards = given, ()
    if columns != names:
        observation = build("slice", given, first=0, last=len(names))
        rewards = (build("slice", given, first=len(names), last=len(columns)),)

    lags = 0 if derivation is None else derivation.lags
    before, acts = policy.history * len(names), max(lags, int(bool(limits))) * policy.act_dim
    observations_before = build.remembered("observations_before", [math.nan] * before) if before else None
    actions_before = build.remembered("actions_before", [math.nan] * acts) if acts else None
    seen, known = observation, None
    if derivation is not None and observations_before is not None:
        seen = _with_history(build, derivation, observation, observations_before, actions_before)
        known = build("smallest", build("finite", seen), axis=WIDTH)

    normalised = _normalised(build, policy, seen)
    scaled = described(build, policy.actor, normalised, *rewards)
    actor_memory = tuple(build.taken_back())
    action = unscaled(build, policy, scaled)
    if limits and actions_before is not None:
        action = _limited(build, policy, limits, action, actions_before)
    return Described(
        build,
        policy,
        observation,
        readable,
        observation,
        known,
        seen,
        normalised,
        scaled,
        action,
        observations_before,
        actions_before,
        actor_memory,
    )


def with_formulas_outside(policy: Policy) -> Policy:
    """The policy that takes what formulas give as readings, under the names that the formulas have."""
    if policy.derivation is None:
        return policy
    parts = tuple((name, None) for name, _ in policy.derivation.parts)
    return replace(policy, derivation=replace(policy.derivation, parts=parts))


def input_columns(policy: Policy) -> tuple[str, ...]:
    """What a step is given: the readings, and where the actor asks for it what the action before has earned.

    Raises:
        ConfigError: a reading has the name of that reward.
    """
    if not policy.actor.takes_rewards:
        return policy.reading_names
    if REWARD in policy.reading_names:
        raise ConfigError(
            f"{REWARD}: is a reading of this policy, and the column in which each step is told the last reward; read "
            "the log with another name for it"
        )
    return (*policy.reading_names, REWARD)


def action_names(policy: Policy) -> tuple[str, ...]:
    """Of the columns of an action; numbered where the policy has none."""
    return policy.action_names or tuple(f"action_{index}" for index in range(policy.act_dim))


def bounds_inside(policy: Policy) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the actions as float32 that lie on the user's bounds or inside, however these round."""
    low, high = np.asarray(policy.action_low), np.asarray(policy.action_high)
    least, most = low.astype(np.float32), high.astype(np.float32)
    least = np.where(least < low, np.nextafter(least, np.float32(np.inf)), least)
    most = np.where(most > high, np.nextafter(most, np.float32(-np.inf)), most)
    return least, most


def _with_history(build: Builder, derivation: Derivation, own: Value, before: Value, actions: Value | None) -> Value:
    """The observation, in the order of `Derivation`."""
    parts, width = [own], own.width
    if derivation.differences:
        parts.append(build("subtract", own, build("slice", before, first=0, last=width)))
    for lag in range(derivation.lags):
        parts.append(build("slice", before, first=lag * width, last=(lag + 1) * width))
        if actions is not None:
            acts = len(derivation.actions)
            parts.append(build("slice", actions, first=lag * acts, last=(lag + 1) * acts))
    return build("concatenate", *parts)


def _normalised(build: Builder, policy: Policy, observation: Value) -> Value:
    """(observation - mean) / scale, and 0 in columns that never varied."""
    normaliser = policy.normaliser
    constant = np.isin(np.arange(policy.obs_dim), normaliser.constant)
    shifted = build("subtract", observation, build.parameter("normaliser/mean", normaliser.shift))
    scale = np.where(constant, np.float32(1.0), normaliser.scale)
    scaled = build("divide", shifted, build.parameter("normaliser/scale", scale))
    if constant.any():
        scaled = build("multiply", scaled, build.constant("normaliser/varies", ~constant))
    return scaled


def unscaled(build: Builder, policy: Policy, scaled: Value) -> Value:
    low, high = np.asarray(policy.action_low, np.float64), np.asarray(policy.action_high, np.float64)
    action = build("multiply", scaled, build.constant("actions/half", (high - low) / 2))
    action = build("add", action, build.constant("actions/centre", (high + low) / 2))
    return clipped(build, action, "actions", *bounds_inside(policy))


def _limited(build: Builder, policy: Policy, limits: Mapping[int, float], action: Value, before: Value) -> Value:
    """The action no farther from the last one than allowed; where none is known, and in other columns, as it is."""
    last = build("slice", before, first=0, last=policy.act_dim)
    columns = range(policy.act_dim)
    change = build.constant("limits/change", [limits.get(column, 0.0) for column in columns])
    limited = build("maximum", action, build("subtract", last, change))
    limited = build("minimum", limited, build("add", last, change))
    applies = build("multiply", build("finite", last), build.constant("limits/applies", [c in limits for c in columns]))
    low, high = bounds_inside(policy)
    return clipped(build, build("select", applies, limited, action), "limits/bounds", low, high)


def _limits(policy: Policy, max_change: Mapping[str, float]) -> dict[int, float]:
    """By the number of the action."""
    names, found = action_names(policy), {}
    for name, change in max_change.items():
        if name not in names:
            raise ConfigError(f"max_change: {name!r} is no action; there are {', '.join(names)}")
        if not (math.isfinite(change) and change > 0.0):
            raise ConfigError(f"max_change: {name}={change} must be a finite number above 0, in the action's unit")
        found[names.index(name)] = float(change)
    return found


def _refuse_formulas(derivation: Derivation) -> None:
    for name, formula in derivation.parts:
        if formula is not None:
            raise ConfigError(
                f"derivation: '{name} = {formula.text}' is a formula, computed in double precision, which no form of "
                "the artefact does; give formulas_outside=True, and at work a reading of that name, computed from the "
                "digits that the plant gives"
            )
