"""Where the time of one learner's update goes: each of its parts timed alone, in a compiled loop of its own."""

import dataclasses
import statistics
import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optax

from benchmarks import learners
from benchmarks.learners import Part
from odaf.components.losses import ensemble_td_gradient
from odaf.components.targets import polyak


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

    def targets(state: Any, batch: Any, key: Any) -> Any:
        return _trace(state, algorithm.targets(state, batch, key))

    def critics(state: Any, batch: Any, key: Any) -> Any:
        del key
        return _trace(state, ensemble_td_gradient(state.critics, batch.observations, batch.actions, batch.rewards)[0])

    def critic_terms(state: Any, batch: Any, key: Any) -> Any:
        return _trace(
            state, eqx.filter_grad(algorithm.critic_additions, has_aux=True)(state.critics, state, batch, key)
        )

    def actor_base(state: Any, batch: Any, key: Any) -> Any:
        plain = dataclasses.replace(state, side=(), memory=())
        return _trace(state, eqx.filter_grad(base.actor_loss, has_aux=True)(state.actor, plain, batch, key)[0])

    def actor(state: Any, batch: Any, key: Any) -> Any:
        return _trace(state, eqx.filter_grad(algorithm.actor_loss, has_aux=True)(state.actor, state, batch, key)[0])

    def optimiser(state: Any, batch: Any, key: Any) -> Any:
        del batch, key
        changes, moments = optax.adam(1e-9).update(state.critics, state.critic_optimiser, state.critics)
        moved: Any = optax.apply_updates(state.critics, changes)
        slow = polyak(state.target_critics.networks, moved.networks, algorithm.target_rate)
        slow = dataclasses.replace(state.target_critics, networks=slow)
        return dataclasses.replace(state, critics=moved, critic_optimiser=moments, target_critics=slow)

    base = dataclasses.replace(algorithm, terms=())
    found: dict[str, Part] = {
        "whole update": lambda state, batch, key: algorithm.update(state, batch, key)[0],
        "batch alone": lambda state, batch, key: _trace(state, batch),
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
    return dataclasses.replace(state, log_temperature=state.log_temperature + 1e-30 * total)


def _seconds(call: Callable[[int], None], count: int) -> float:
    start = time.perf_counter()
    call(count)
    return time.perf_counter() - start
