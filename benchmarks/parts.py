"""Where the time of one learner's update goes: each of its parts timed alone, in a compiled loop of its own."""

import dataclasses
import statistics
import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from benchmarks import learners
from benchmarks.learners import Part
from odaf.algorithms.numbers import changed
from odaf.components.losses import ensemble_td_gradient


def show(name: str, rounds: int, seconds: float) -> dict[str, float]:
    """Measure, print and return the milliseconds of each part, the median of interleaved rounds."""
    algorithm, rows = learners.load(name), learners.columns()
    calls, counts = {}, {}
    for part, function in parts_of(algorithm).items():
        calls[part] = learners.repeated(algorithm, rows, function, learners.state_of(algorithm))
        calls[part](1)
        counts[part] = max(1, round(2 * seconds / _seconds(calls[part], 2)))
    times: dict[str, list[float]] = {part: [] for part in calls}
    for _ in range(rounds):
        for part, call in calls.items():
            times[part].append(1e3 * _seconds(call, counts[part]) / counts[part])
    found = {part: statistics.median(taken) for part, taken in times.items()}
    whole = found["whole update"]
    for part, taken in found.items():
        print(f"{name}: {part:42} {taken:8.2f} ms  {taken / whole:5.0%}")
    return found


def parts_of(algorithm: Any) -> dict[str, Part]:
    """The parts by name. Each leaves a trace of its result in the state, so that the compiler cannot drop it."""

    def targets(learner: Any, state: Any, batch: Any, key: Any) -> Any:
        return _trace(state, learner.targets(state, batch, key))

    def critics(learner: Any, state: Any, batch: Any, key: Any) -> Any:
        del learner, key
        gradient, *_ = ensemble_td_gradient(state.online_critics, batch.observations, batch.actions, batch.rewards)
        return _trace(state, gradient)

    def critic_terms(learner: Any, state: Any, batch: Any, key: Any) -> Any:
        additions = eqx.filter_grad(learner.critic_additions, has_aux=True)
        return _trace(state, additions(state.online_critics, state, batch, key))

    def actor_base(learner: Any, state: Any, batch: Any, key: Any) -> Any:
        return actor(changed(learner, {"terms": ()}), dataclasses.replace(state, terms=()), batch, key)

    def actor(learner: Any, state: Any, batch: Any, key: Any) -> Any:
        return _trace(state, eqx.filter_grad(learner.actor_loss, has_aux=True)(state.actor.now, state, batch, key)[0])

    def optimiser(learner: Any, state: Any, batch: Any, key: Any) -> Any:
        del batch, key
        return dataclasses.replace(state, critics=state.critics.stepped(state.critics.now, 1e-9, learner.target_rate))

    found: dict[str, Part] = {
        "whole update": lambda learner, state, batch, key: learner.update(state, batch, key)[0],
        "batch alone": lambda learner, state, batch, key: _trace(state, batch),
        "targets": targets,
        "critics' gradient": critics,
    }
    if any(term.acts_on_critics for term in algorithm.active_terms):
        found["what terms add to the critics' gradient"] = critic_terms
    found["actor's gradient without terms"] = actor_base
    if any(term.acts_on_actor for term in algorithm.active_terms):
        found["actor's gradient with terms"] = actor
    found["critics' Adam and target average"] = optimiser
    return found


def _trace(state: Any, result: Any) -> Any:
    """The state, changed by something far too small to matter that needs every number of the result."""
    total = sum(jnp.sum(leaf) for leaf in jax.tree.leaves(eqx.filter(result, eqx.is_inexact_array)))
    moved = dataclasses.replace(state.log_temperature, now=state.log_temperature.now + 1e-30 * total)
    return dataclasses.replace(state, log_temperature=moved)


def _seconds(call: Callable[[int], None], count: int) -> float:
    start = time.perf_counter()
    call(count)
    return time.perf_counter() - start
