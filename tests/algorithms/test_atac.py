"""ATAC against its formulas in float64 NumPy; the order of its steps is that of the authors' code."""

import dataclasses

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import networks, tiny
from odaf.algorithms.atac import ATAC, ATACState, projected, tempered
from odaf.components.adam import initial_moments
from odaf.components.critics import CriticEnsemble
from odaf.components.trained import Trained
from odaf.errors import ConfigError
from odaf.runs import presets

LEARNER = ATAC(
    hidden_sizes=(5, 4),
    batch_size=tiny.ROWS,
    bellman_weight=4.0,
    residual_weight=0.3,
    weight_norm=2.0,
    discount=0.9,
    reward_shift=-1.0,
    target_rate=0.25,
    warm_start_updates=3,
)
KEY = 7


def _state(step: int) -> ATACState:
    """Different random networks, a temperature of 1.5, the actor's optimiser after three steps."""
    shape = jax.eval_shape(lambda: LEARNER.init(jr.key(0), tiny.SPEC, ()))
    empty = tiny.filled(shape, size=0.0)
    moments = jax.tree.map(lambda leaf: leaf + 3, empty.actor.moments)
    return dataclasses.replace(
        empty,
        step=jnp.asarray(step),
        actor=Trained(tiny.filled(shape.actor.now, 1), None, moments),
        critics=Trained(tiny.filled(shape.critics.now, 3), tiny.filled(shape.critics.slow, 4), empty.critics.moments),
        log_temperature=Trained(tiny.floats(np.log(1.5)), None, empty.log_temperature.moments),
    )


def _act(actor, observations, noise) -> tuple[np.ndarray, np.ndarray]:
    mean, output = np.split(networks.mlp(actor.network, observations), 2, axis=1)
    std = np.minimum(np.maximum(np.exp(output), 1e-5), 10.0)
    z = mean + std * networks.numbers(noise)
    density = np.exp(-0.5 * ((z - mean) / std) ** 2) / (std * np.sqrt(2.0 * np.pi) * (1.0 - np.tanh(z) ** 2))
    return np.tanh(z), np.sum(np.log(density), axis=1)


def _target(state, batch, next_actions) -> np.ndarray:
    after = networks.q_values(CriticEnsemble(state.critics.slow), batch.next_observations, next_actions).min(axis=0)
    return networks.numbers(batch.rewards) - 1.0 + 0.9 * (1.0 - networks.numbers(batch.terminated)) * after


def _critic_loss(critics, k, batch, y, next_actions, actions, beta, is_warm) -> float:
    """One critic's loss, with its own value of the next state on both sides of the residual."""
    logged = networks.q_values(critics, batch.observations, batch.actions)[k]
    following = networks.q_values(critics, batch.next_observations, next_actions)[k]
    chosen = networks.q_values(critics, batch.observations, actions)[k]
    own = networks.numbers(batch.rewards) - 1.0 + 0.9 * (1.0 - networks.numbers(batch.terminated)) * following
    bellman = 0.7 * np.mean((logged - y) ** 2) + 0.3 * np.mean((logged - own) ** 2)
    if is_warm:
        return float(bellman)
    pessimism = np.mean(chosen) - np.mean(logged)
    return float(pessimism / beta + bellman if beta > 1.0 else pessimism + beta * bellman)


@pytest.mark.parametrize(("beta", "is_warm"), [(4.0, False), (0.5, False), (4.0, True)])
def test_a_critic_follows_its_formula_through_both_sides_of_the_residual(beta, is_warm):
    learner = dataclasses.replace(LEARNER, bellman_weight=beta)
    rng = np.random.default_rng(0)
    with tiny.exactly():
        state, batch = _state(3), tiny.batch()
        next_actions, actions = (tiny.floats(rng.uniform(-1.0, 1.0, batch.actions.shape)) for _ in range(2))
        y = _target(state, batch, next_actions)
        np.testing.assert_allclose(learner.target(state, batch, next_actions), y, rtol=1e-9)
        given = (batch, tiny.floats(y), next_actions, actions, jnp.asarray(is_warm))
        one = CriticEnsemble(jax.tree.map(lambda leaf: leaf[1], state.critics.now))
        loss, _ = learner.critic_loss(one, *given)
        critics = CriticEnsemble(state.critics.now)
        np.testing.assert_allclose(loss, _critic_loss(critics, 1, *given[:4], beta, is_warm), rtol=1e-9)
        gradient = jax.grad(lambda critic: learner.critic_loss(critic, *given)[0])(one)

        def expected(member):
            alone = jax.tree.map(lambda leaf: np.asarray(leaf)[None], member)
            return _critic_loss(alone, 0, *given[:4], beta, is_warm)

        tiny.assert_slopes(gradient, expected, one)
        assert tiny.all_zero(jax.grad(lambda y: learner.critic_loss(one, batch, y, *given[2:])[0])(given[1]))


def test_targets_are_cut_after_the_backup():
    with tiny.exactly():
        state, batch = _state(3), tiny.batch()
        y = _target(state, batch, batch.actions)
        low, high = np.sort(y)[1] + 1e-3, np.sort(y)[-2] - 1e-3
        learner = dataclasses.replace(LEARNER, value_min=float(low), value_max=float(high))
        np.testing.assert_allclose(learner.target(state, batch, batch.actions), np.clip(y, low, high), rtol=1e-6)


@pytest.mark.parametrize("step", [2, 3, 4])
def test_an_update_goes_critics_then_alpha_then_the_actor_at_a_pace_of_its_own(step):
    is_warm = step < 3
    with tiny.exactly():
        state, batch = _state(step), tiny.batch()
        with tiny.recorded() as drawn:
            one, metrics = LEARNER.update(state, batch, jr.key(KEY))
        noise, next_noise = drawn
        temperature = jnp.exp(one.log_temperature.now)
        shown = (CriticEnsemble(one.critics.now), batch)
        next_actions, actions = (
            _act(state.actor.now, rows, normal)[0]
            for rows, normal in ((batch.next_observations, next_noise), (batch.observations, noise))
        )
        given = (batch, _target(state, batch, next_actions), next_actions, actions)
        bellman = sum(_critic_loss(CriticEnsemble(state.critics.now), k, *given, 4.0, True) for k in range(2))
        np.testing.assert_allclose(metrics["critic/loss"], bellman, rtol=1e-8)

        def expected(actor):
            actions, density = _act(actor, batch.observations, noise)
            aim = -networks.q_values(shown[0], batch.observations, actions)[0].mean()
            if is_warm:
                mean, output = np.split(networks.mlp(actor.network, batch.observations), 2, axis=1)
                std, logged = np.exp(output), networks.numbers(batch.actions)
                normal = -0.5 * ((np.arctanh(logged) - mean) / std) ** 2 - np.log(std * np.sqrt(2.0 * np.pi))
                aim = -np.mean(np.sum(normal - np.log(1.0 - logged**2), axis=1))
            alpha = float(temperature)
            return float(aim / alpha + density.mean() if alpha > 1.0 else aim + alpha * density.mean())

        np.testing.assert_allclose(metrics["actor/loss"], expected(state.actor.now), rtol=1e-8)
        loss = lambda actor: LEARNER.actor_loss(actor, *shown, tiny.floats(noise), temperature, jnp.asarray(is_warm))[0]  # noqa: E731
        gradient = jax.grad(loss)(state.actor.now)
        tiny.assert_slopes(gradient, expected, state.actor.now)
        moments = initial_moments(state.actor.now) if step == 3 else state.actor.moments
        rate = 5e-4 if is_warm else 5e-7
        wanted = Trained(state.actor.now, None, moments).stepped(gradient, rate)
        tiny.assert_close(one.actor.now, wanted.now, atol=1e-12)
        assert int(jax.tree.leaves(one.actor.moments)[0]) == (1 if step == 3 else 4)

    norms = [np.sqrt(np.sum(np.square(w), axis=(1, 2))) for w in one.critics.now.weights]
    assert max(n.max() for n in norms) < 2.0 + 1e-9 and max(n.max() for n in norms) > 2.0 - 1e-9
    slow = jax.tree.map(lambda s, n: 0.75 * np.asarray(s) + 0.25 * np.asarray(n), state.critics.slow, one.critics.now)
    tiny.assert_close(one.critics.slow, slow, atol=1e-9)


def test_matrices_are_projected_one_by_one_and_biases_are_left():
    with tiny.exactly():
        before = tiny.filled(_state(0).critics.now, 5)
        after = projected(before, 2.0)
    for old, new in zip(before.weights, after.weights, strict=True):
        for matrix, found in zip(np.asarray(old), np.asarray(new), strict=True):
            np.testing.assert_allclose(found, matrix * min(1.0, 2.0 / np.linalg.norm(matrix)), rtol=1e-9)
    tiny.assert_same_bits(before.biases, after.biases)


def test_a_large_weight_divides_instead():
    with tiny.exactly():
        values = [float(tempered(tiny.floats(3.0), tiny.floats(5.0), weight)) for weight in (0.5, 1.0, 4.0)]
    np.testing.assert_allclose(values, [5.5, 8.0, 5.75])


def test_it_begins_with_a_spread_of_one_and_slow_critics_that_equal_the_critics():
    state = LEARNER.init(jr.key(0), tiny.SPEC, ())
    _, log_std = state.actor.now.parameters(jnp.ones((2, tiny.OBS_DIM)))
    np.testing.assert_allclose(log_std, 0.0, atol=0.01)
    tiny.assert_same_bits(state.critics.now, state.critics.slow)


def test_presets_are_as_published():
    base, light = presets.load("atac"), presets.load("atac-light")
    assert (base.bellman_weight, light.bellman_weight) == (16.0, 3.0)
    assert (base.actor_learning_rate, base.critic_learning_rate, base.warm_start_updates) == (5e-7, 5e-4, 100_000)
    assert presets.load("atac", task="hopper-medium") == base
    maze = presets.load("atac", task="antmaze-large-play")
    assert (maze.reward_shift, maze.value_min, maze.value_max) == (-1.0, -100.0, 0.0)
    assert len(presets.tasks("atac")) == 21


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("discount", 1.0),
        ("target_rate", 0.0),
        ("residual_weight", 1.5),
        ("bellman_weight", 0.0),
        ("batch_size", 0),
        ("warm_start_updates", -1),
    ],
)
def test_impossible_settings_are_named(field, value):
    with pytest.raises(ConfigError, match=field):
        ATAC(**{field: value})
    with pytest.raises(ConfigError, match="value_min=1.0 must be below value_max=0.0"):
        ATAC(value_min=1.0, value_max=0.0)
