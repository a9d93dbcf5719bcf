"""BEAR against its formulas, in float64 NumPy."""

import dataclasses

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import constraints, networks, tiny
from odaf.algorithms.bear import BEAR, BEARState
from odaf.components.critics import CriticEnsemble
from odaf.components.trained import Trained
from odaf.errors import ConfigError
from odaf.runs import presets

LEARNER = BEAR(
    hidden_sizes=(5, 4),
    behaviour_hidden_sizes=(4, 5),
    batch_size=tiny.ROWS,
    kernel_width=3.0,
    threshold=0.2,
    num_draws=3,
    num_actions=7,
    num_candidates=9,
    discount=0.9,
    target_rate=0.25,
    actor_learning_rate=1e-2,
    critic_learning_rate=2e-2,
    behaviour_learning_rate=3e-2,
    weight_learning_rate=4e-2,
)


def _state(step: int = 40_000) -> BEARState:
    """Different random networks, log alpha 0.5; draws are far out before the tanh."""
    shape = jax.eval_shape(lambda: LEARNER.init(jr.key(0), tiny.SPEC, ()))
    empty = tiny.filled(shape, size=0.0)

    def filled(part: str, seed: int, size: float):
        trained = getattr(shape, part)
        slow = None if trained.slow is None else tiny.filled(trained.slow, seed + 1, size)
        return Trained(tiny.filled(trained.now, seed, size), slow, getattr(empty, part).moments)

    return dataclasses.replace(
        empty,
        step=jnp.asarray(step),
        behaviour=filled("behaviour", 1, 1.0),
        critics=filled("critics", 3, 0.8),
        actor=filled("actor", 5, 1.0),
        log_weight=Trained(tiny.floats(0.5), None, empty.log_weight.moments),
    )


def _draws(actor, observations, noise) -> np.ndarray:
    mean, std = networks.gaussian(actor, observations)
    return mean + std * noise


def _discrepancy(x, y, kernel: str) -> np.ndarray:
    def likeness(first, second):
        gaps = first[:, None] - second[None]
        distance = np.sum(gaps**2 if kernel == "gaussian" else np.abs(gaps), axis=-1)
        return np.exp(-distance / (2.0 * 3.0)).mean(axis=(0, 1))

    return np.sqrt(likeness(x, x) + likeness(y, y) - 2.0 * likeness(x, y) + 1e-6)


def _actor_loss(actor, behaviour, critics, batch, noise, latent, counts: float, kernel: str = "gaussian") -> float:
    x = _draws(actor, batch.observations, noise)
    y = np.stack([constraints.decoded(behaviour, batch.observations, one) for one in latent])
    values = networks.q_values(critics, batch.observations, np.tanh(x[0])).min(axis=0)
    return float(np.mean(np.exp(0.5) * (_discrepancy(x, y, kernel) - 0.2) - counts * values))


def _target(state, batch, noise) -> np.ndarray:
    candidates = np.tanh(_draws(state.actor.now, batch.next_observations, noise))
    return constraints.best_target(state.critics.slow, batch, candidates, 0.9)


def test_the_target_takes_the_best_of_the_actors_own_draws():
    with tiny.exactly():
        state, batch = _state(), tiny.batch()
        with tiny.recorded() as drawn:
            y = LEARNER.target(state, batch, jr.key(5))
        assert drawn[0].shape == (7, tiny.ROWS, tiny.ACT_DIM)
        np.testing.assert_allclose(y, _target(state, batch, drawn[0]), rtol=1e-9)


@pytest.mark.parametrize("kernel", ["gaussian", "laplacian"])
@pytest.mark.parametrize(("step", "counts"), [(39_999, 0.0), (40_000, 1.0)])
def test_the_actor_is_held_to_the_log_before_the_tanh_and_climbs_the_lower_critic_after_the_warm_up(
    kernel, step, counts
):
    learner = dataclasses.replace(LEARNER, kernel=kernel)
    with tiny.exactly():
        state, batch, critics = _state(step), tiny.batch(), CriticEnsemble(_state().critics.now)
        actor, behaviour = state.actor.now, state.behaviour.now
        with tiny.recorded() as drawn:
            (loss, metrics), slope = jax.value_and_grad(learner.actor_loss, has_aux=True)(
                actor, state, behaviour, critics, batch, jr.key(7)
            )
        noise, latent = drawn
        assert np.abs(noise).max() > 0.5 and np.abs(latent).max() > 0.5  # of the two only z is cut

        def wanted(actor):
            return _actor_loss(actor, behaviour, critics, batch, noise, latent, counts, kernel)

        np.testing.assert_allclose(loss, wanted(actor), rtol=1e-9)
        tiny.assert_slopes(slope, wanted, actor)
        assert 0.0 < float(metrics["actor/discrepancy"]) < 2.0

        def of_others(behaviour, critics, log_weight):
            weight = Trained(log_weight, None, state.log_weight.moments)
            moved = dataclasses.replace(state, log_weight=weight)
            return learner.actor_loss(actor, moved, behaviour, critics, batch, jr.key(7))[0]

        slopes = jax.grad(of_others, argnums=(0, 1, 2))(behaviour, critics, state.log_weight.now)
        assert tiny.all_zero(slopes)


def test_a_step_takes_the_model_first_then_critics_then_the_actor_and_the_actor_has_no_slow_copy():
    with tiny.exactly():
        state, batch = _state(), tiny.batch()
        with tiny.recorded() as drawn:
            after, metrics = LEARNER.update(state, batch, jr.key(1))
        for_model, for_target, noise, latent = drawn
        loss = constraints.behaviour_loss(state.behaviour.now, batch, for_model)
        np.testing.assert_allclose(metrics["behaviour/loss"], loss, rtol=1e-9)
        y = _target(state, batch, for_target)
        np.testing.assert_allclose(metrics["target/mean"], y.mean(), rtol=1e-9)
        values = networks.q_values(CriticEnsemble(state.critics.now), batch.observations, batch.actions)
        np.testing.assert_allclose(metrics["critic/loss"], np.sum(np.mean((values - y) ** 2, axis=1)), rtol=1e-8)
        models = after.behaviour.now, CriticEnsemble(after.critics.now)
        loss = _actor_loss(state.actor.now, *models, batch, noise, latent, 1.0)
        np.testing.assert_allclose(metrics["actor/loss"], loss, rtol=1e-6)  # against both as they are now
        old = _actor_loss(state.actor.now, state.behaviour.now, models[1], batch, noise, latent, 1.0)
        assert abs(loss - old) > 1e-5
    expected = jax.tree.map(
        lambda slow, now: 0.75 * np.asarray(slow) + 0.25 * np.asarray(now), state.critics.slow, after.critics.now
    )
    tiny.assert_close(after.critics.slow, expected, atol=1e-9)
    assert after.actor.slow is None and after.behaviour.slow is None
    # Adam's first step has the size of its rate
    for part, rate in (("actor", 1e-2), ("critics", 2e-2), ("behaviour", 3e-2)):
        before, now = getattr(state, part).now, getattr(after, part).now
        steps = jax.tree.map(lambda a, b: np.abs(np.asarray(a) - np.asarray(b)).max(), before, now)
        np.testing.assert_allclose(max(jax.tree.leaves(steps)), rate, rtol=1e-3)


@pytest.mark.parametrize(("threshold", "moved"), [(1e-3, 0.54), (5.0, 0.46)])
@pytest.mark.parametrize("step", [0, 40_000])
def test_alpha_climbs_while_the_constraint_is_broken_and_falls_while_it_holds_in_the_warm_up_too(
    threshold, moved, step
):
    learner = dataclasses.replace(LEARNER, threshold=threshold)
    with tiny.exactly():
        after, metrics = learner.update(_state(step), tiny.batch(), jr.key(1))
        np.testing.assert_allclose(after.log_weight.now, moved, rtol=1e-5)
        np.testing.assert_allclose(metrics["actor/weight"], np.exp(moved), rtol=1e-5)


def test_the_trained_policy_is_the_best_of_its_draws_by_the_first_critic():
    with tiny.exactly():
        state, rows = _state(), tiny.batch().observations
        actor = LEARNER.actor(state)
        noise = np.broadcast_to(np.asarray(actor.noise)[:, None], (9, tiny.ROWS, tiny.ACT_DIM))
        candidates = np.tanh(_draws(state.actor.now, rows, noise))
        np.testing.assert_allclose(
            actor.mode(rows), constraints.best_by_first(state.critics.now, rows, candidates), rtol=1e-6
        )
        with tiny.recorded() as drawn:
            chosen, _ = actor.act((), rows, jr.key(2))
        fresh = np.tanh(_draws(state.actor.now, rows, drawn[0]))
        np.testing.assert_allclose(chosen, constraints.best_by_first(state.critics.now, rows, fresh), rtol=1e-6)


def test_alpha_starts_at_one():
    assert float(LEARNER.init(jr.key(0), tiny.SPEC, ()).log_weight.now) == 0.0


@pytest.mark.parametrize(
    ("task", "kernel"),
    [("halfcheetah-random", "gaussian"), ("hopper-medium", "laplacian"), ("walker2d-expert", "laplacian")],
)
def test_tasks_have_the_kernels_that_are_known(task, kernel):
    learner = presets.load("bear", task=task)
    assert (learner.kernel, learner.kernel_width, learner.threshold) == (kernel, 20.0, 0.05)
    assert len(presets.tasks("bear")) == 15
    assert presets.load("bear") == BEAR()
    assert (learner.actor_learning_rate, learner.critic_learning_rate) == (1e-4, 3e-4)
    assert (learner.num_draws, learner.num_actions, learner.warm_up_steps) == (4, 10, 40_000)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("discount", 1.0),
        ("target_rate", 0.0),
        ("kernel_width", 0.0),
        ("threshold", -0.1),
        ("lowest_weight", -0.5),
        ("num_draws", 0),
        ("num_candidates", 0),
    ],
)
def test_impossible_settings_are_named(field, value):
    with pytest.raises(ConfigError, match=field):
        BEAR(**{field: value})
