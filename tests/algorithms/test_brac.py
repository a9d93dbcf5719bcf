"""BRAC against its formulas, in float64 NumPy."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import networks, tiny
from odaf.algorithms.brac import BRAC, BRACState
from odaf.components.behaviour_models import gaussian_loss
from odaf.components.critics import CriticEnsemble
from odaf.components.losses import ensemble_td_gradient
from odaf.components.trained import Trained
from odaf.errors import ConfigError
from odaf.runs import presets

LEARNER = BRAC(
    hidden_sizes=(5, 4),
    critic_hidden_sizes=(4, 5),
    batch_size=tiny.ROWS,
    weight=0.7,
    discount=0.9,
    target_rate=0.25,
    actor_learning_rate=1e-2,
    critic_learning_rate=2e-2,
)
DRAWS = 4


def _weight(state: BRACState) -> float:
    assert state.weight is not None
    return float(state.weight.now)


def _slow(state: BRACState) -> CriticEnsemble:
    assert state.critics.slow is not None
    return CriticEnsemble(state.critics.slow)


def _state(learner: BRAC = LEARNER, step: int = 20_000) -> BRACState:
    """Different random networks; the actor's actions reach the bounds."""
    key = jr.key(0)
    shape = jax.eval_shape(lambda: learner.init(key, tiny.SPEC, learner.untrained(key, tiny.SPEC)))
    empty = tiny.filled(shape, size=0.0)
    actor, critics = shape.actor, shape.critics
    return dataclasses.replace(
        empty,
        step=jnp.asarray(step),
        actor=Trained(tiny.filled(actor.now, 1, 1.5), None, empty.actor.moments),
        critics=Trained(tiny.filled(critics.now, 3), tiny.filled(critics.slow, 4), empty.critics.moments),
        behaviour=tiny.filled(shape.behaviour, 5),
        weight=None if shape.weight is None else Trained(tiny.floats(learner.weight), None, empty.weight.moments),
    )


def _parameters(actor, observations) -> tuple[np.ndarray, np.ndarray]:
    output = networks.mlp(actor.network, observations)
    return output[:, :2], np.exp(-5.0 + 2.5 * (np.tanh(output[:, 2:]) + 1.0))


def _log_density(mean, std, before: np.ndarray) -> np.ndarray:
    normal = -0.5 * ((before - mean) / std) ** 2 - np.log(std * np.sqrt(2.0 * np.pi))
    return np.sum(normal + 2.0 * np.log(np.cosh(before)), axis=-1)


def _draws(actor, observations, noise) -> tuple[np.ndarray, np.ndarray]:
    mean, std = _parameters(actor, observations)
    before = mean + std * noise
    return np.tanh(before), _log_density(mean, std, before)


def _logged(behaviour, observations, actions) -> np.ndarray:
    return _log_density(*_parameters(behaviour, observations), np.arctanh(np.clip(actions, -0.999, 0.999)))


def _divergence(actor, behaviour, observations, noise) -> np.ndarray:
    found = []
    for one in noise:
        actions, log_density = _draws(actor, observations, one)
        found.append(log_density - _logged(behaviour, observations, actions))
    return np.mean(found, axis=0)


def _target(state, batch, noise, penalty: float) -> np.ndarray:
    actions, _ = _draws(state.actor.now, batch.next_observations, noise[0])
    values = networks.q_values(_slow(state), batch.next_observations, actions).min(axis=0)
    if penalty:
        values -= penalty * _divergence(state.actor.now, state.behaviour, batch.next_observations, noise[1:])
    return np.array(
        [
            float(batch.rewards[row]) + (0.0 if row in (2, 5) else 0.9 * values[row])  # rows 2 and 5 truly end
            for row in range(tiny.ROWS)
        ]
    )


def _actor_loss(actor, state, critics, batch, noise, counts: float) -> float:
    actions, _ = _draws(actor, batch.observations, noise[0])
    values = networks.q_values(critics, batch.observations, actions).min(axis=0)
    divergence = _divergence(actor, state.behaviour, batch.observations, noise[1:])
    return float(np.mean(0.7 * divergence - counts * values))


@pytest.mark.parametrize("value_penalty", [True, False])
def test_the_target_pays_for_the_divergence_at_the_successor_in_brac_v_alone(value_penalty):
    learner = dataclasses.replace(LEARNER, value_penalty=value_penalty)
    with tiny.exactly():
        state, batch = _state(), tiny.batch()
        with tiny.recorded() as drawn:
            y = learner.target(state, batch, jr.key(5))
        assert drawn[0].shape[0] == (1 + DRAWS if value_penalty else 1)
        np.testing.assert_allclose(y, _target(state, batch, drawn[0], 0.7 if value_penalty else 0.0), rtol=1e-8)


def test_the_target_with_its_penalty_gets_no_gradient():
    with tiny.exactly():
        state, batch = _state(), tiny.batch()

        def loss(actor, behaviour):
            moved = dataclasses.replace(state, actor=Trained(actor, None, state.actor.moments), behaviour=behaviour)
            y = LEARNER.target(moved, batch, jr.key(5))
            return ensemble_td_gradient(CriticEnsemble(state.critics.now), batch.observations, batch.actions, y)[1]

        assert tiny.all_zero(jax.grad(loss, argnums=(0, 1))(state.actor.now, state.behaviour))


@pytest.mark.parametrize(("step", "counts"), [(19_999, 0.0), (20_000, 1.0)])
def test_the_actor_fits_the_divergence_alone_at_first_and_slopes_pass_through_both_logarithms(step, counts):
    with tiny.exactly():
        state, batch, critics = _state(step=step), tiny.batch(), CriticEnsemble(_state().critics.now)
        with tiny.recorded() as drawn:
            (loss, metrics), slope = jax.value_and_grad(LEARNER.actor_loss, has_aux=True)(
                state.actor.now, state, critics, batch, jr.key(7)
            )
        noise = drawn[0]
        np.testing.assert_allclose(loss, _actor_loss(state.actor.now, state, critics, batch, noise, counts), rtol=1e-8)
        tiny.assert_slopes(
            slope, lambda a: _actor_loss(a, state, critics, batch, noise, counts), state.actor.now, rtol=1e-4
        )
        # cut inside log beta alone: an action beyond the cut keeps its own log pi, and is valued as it is
        actions, _ = _draws(state.actor.now, batch.observations, noise)
        share = np.mean(np.abs(actions) > 0.999)
        assert 0.05 < share < 0.95
        assert tiny.all_zero(
            jax.grad(lambda c: LEARNER.actor_loss(state.actor.now, state, c, batch, jr.key(7))[0])(critics)
        )
        divergence = _divergence(state.actor.now, state.behaviour, batch.observations, noise[1:])
        np.testing.assert_allclose(metrics["actor/divergence"], divergence.mean(), rtol=1e-8)


def test_critics_step_first_their_slow_copies_follow_each_time_and_the_actor_has_none():
    with tiny.exactly():
        state, batch = _state(), tiny.batch()
        with tiny.recorded() as drawn:
            after, metrics = LEARNER.update(state, batch, jr.key(1))
        y = _target(state, batch, drawn[0], 0.7)
        np.testing.assert_allclose(metrics["target/mean"], y.mean(), rtol=1e-8)
        values = networks.q_values(CriticEnsemble(state.critics.now), batch.observations, batch.actions)
        np.testing.assert_allclose(metrics["critic/loss"], np.sum(np.mean((values - y) ** 2, axis=1)), rtol=1e-8)
        noise = next(draw for draw in drawn[1:] if draw.ndim == 3)
        new = CriticEnsemble(after.critics.now)
        loss = _actor_loss(state.actor.now, state, new, batch, noise, 1.0)
        np.testing.assert_allclose(metrics["actor/loss"], loss, rtol=1e-6)  # against the new critics
        old = _actor_loss(state.actor.now, state, CriticEnsemble(state.critics.now), batch, noise, 1.0)
        assert abs(loss - old) > 1e-4
    expected = jax.tree.map(
        lambda slow, now: 0.75 * np.asarray(slow) + 0.25 * np.asarray(now), state.critics.slow, after.critics.now
    )
    tiny.assert_close(after.critics.slow, expected, atol=1e-9)
    assert after.actor.slow is None and after.weight is None and int(after.step) == 20_001
    tiny.assert_same_bits(after.behaviour, state.behaviour)
    # Adam's first step has the size of its rate
    for before, now, rate in ((state.actor, after.actor, 1e-2), (state.critics, after.critics, 2e-2)):
        steps = jax.tree.map(lambda a, b: np.abs(np.asarray(a) - np.asarray(b)).max(), before.now, now.now)
        np.testing.assert_allclose(max(jax.tree.leaves(steps)), rate, rtol=1e-3)


@pytest.mark.parametrize(("target", "rises"), [(-1e9, True), (1e9, False)])
def test_a_learned_weight_climbs_while_the_divergence_is_above_its_target(target, rises):
    learner = dataclasses.replace(LEARNER, target_divergence=target, weight_learning_rate=0.1)
    with tiny.exactly():
        state = _state(learner)
        after, metrics = learner.update(state, tiny.batch(), jr.key(1))
        np.testing.assert_allclose(_weight(after), 0.8 if rises else 0.6, rtol=1e-6)
        np.testing.assert_allclose(metrics["actor/weight"], _weight(after))
        fast = dataclasses.replace(learner, weight_learning_rate=1e4)
        assert _weight(fast.update(state, tiny.batch(), jr.key(1))[0]) == (500.0 if rises else 0.0)
        fixed = dataclasses.replace(LEARNER, weight=_weight(after))
        y = learner.target(after, tiny.batch(), jr.key(2))
        same = dataclasses.replace(after, weight=None)
        np.testing.assert_allclose(y, fixed.target(same, tiny.batch(), jr.key(2)), rtol=1e-12)


def test_the_discrepancy_is_taken_after_the_tanh_squared_and_by_a_laplacian_kernel():
    learner = dataclasses.replace(LEARNER, divergence="mmd")
    with tiny.exactly():
        state, batch = _state(), tiny.batch()
        with tiny.recorded() as drawn:
            y = learner.target(state, batch, jr.key(5))
        actions, _ = _draws(state.actor.now, batch.next_observations, drawn[0])
        logged, _ = _draws(state.behaviour, batch.next_observations, drawn[1])

        def likeness(x, z):
            return np.mean([[np.exp(-np.abs(a - b).sum(axis=-1) / 20.0) for a in x] for b in z], axis=(0, 1))

        own = actions[1:]
        apart = likeness(own, own) + likeness(logged, logged) - 2.0 * likeness(own, logged)
        values = networks.q_values(_slow(state), batch.next_observations, actions[0]).min(axis=0)
        alive = 1.0 - np.asarray(batch.terminated)
        np.testing.assert_allclose(y, np.asarray(batch.rewards) + 0.9 * alive * (values - 0.7 * apart), rtol=1e-8)


def _fitting_loss(observations, actions, noise, alpha: float, actor) -> float:
    log_drawn = _draws(actor, observations, noise)[1]
    return float(np.mean(alpha * log_drawn) - np.mean(_logged(actor, observations, np.asarray(actions))))


def test_beta_is_fitted_to_the_cut_actions_with_an_entropy_that_is_kept_up():
    with tiny.exactly():
        batch = tiny.batch()
        actions = batch.actions.at[0, 0].set(1.0)
        actor = _state().behaviour
        columns = (batch.observations, actions, batch.next_observations)
        for temperature in (0.3, -0.3):  # below 0 it counts for nothing, but can come back
            with tiny.recorded() as drawn:
                (_, figures), (slope, up) = jax.value_and_grad(gaussian_loss, has_aux=True)(
                    (actor, tiny.floats(temperature)), columns, jr.key(3)
                )
            noise, alpha = drawn[0], max(temperature, 0.0)
            tiny.assert_slopes(
                slope, functools.partial(_fitting_loss, batch.observations, actions, noise, alpha), actor
            )
            entropy = -np.mean(_draws(actor, batch.observations, noise)[1])
            np.testing.assert_allclose(up, entropy + tiny.ACT_DIM, rtol=1e-9)  # descent: too little entropy raises it
            np.testing.assert_allclose(figures["entropy"], entropy, rtol=1e-9)


@pytest.mark.parametrize(("name", "penalty"), [("brac-p", False), ("brac-v", True)])
def test_presets_are_as_the_benchmark_ran_them(name, penalty):
    learner = presets.load(name)
    assert learner.value_penalty is penalty and learner.weight == 1.0 and learner.divergence == "kl"
    assert (learner.actor_learning_rate, learner.critic_learning_rate) == (3e-5, 1e-3)
    assert (learner.hidden_sizes, learner.critic_hidden_sizes, learner.warm_up_steps) == (
        (200, 200),
        (300, 300),
        20_000,
    )
    assert (learner.behaviour.hidden_sizes, learner.behaviour.learning_rate) == ((200, 200), 5e-4)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("discount", 1.0),
        ("target_rate", 0.0),
        ("weight", -1.0),
        ("weight", 501.0),
        ("num_draws", 0),
        ("warm_up_steps", -1),
    ],
)
def test_impossible_settings_are_named(field, value):
    with pytest.raises(ConfigError, match=field):
        BRAC(**{field: value})
