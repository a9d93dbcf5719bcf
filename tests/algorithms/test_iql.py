"""IQL against its formulas, in float64 NumPy; the order of its steps is that of the paper's released code."""

import dataclasses

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from scipy import stats

from golden import networks, tiny
from odaf.algorithms.iql import IQL, IQLState, actor_loss, cloning_weights, value_loss
from odaf.components.critics import CriticEnsemble
from odaf.components.policies import DeterministicActor, UnsquashedGaussianActor
from odaf.components.trained import Trained
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError
from odaf.runs import presets
from odaf.training.monitors import DivergenceMonitor, value_bounds

LEARNER = IQL(
    hidden_sizes=(5, 4),
    batch_size=tiny.ROWS,
    discount=0.9,
    target_rate=0.25,
    learning_rate=1e-2,
    reward_scale=0.5,
    reward_shift=-1.0,
)
MEAN_ACTION = IQL(hidden_sizes=(5, 4), actor_kind="deterministic", reward_scale=1.0)


def _state(learner: IQL = LEARNER) -> IQLState:
    """Four different random networks."""
    shape = jax.eval_shape(lambda: learner.init(jr.key(0), tiny.SPEC, ()))
    empty = tiny.filled(shape, size=0.0)
    return dataclasses.replace(
        empty,
        actor=Trained(tiny.filled(shape.actor.now, 1), None, empty.actor.moments),
        value=Trained(tiny.filled(shape.value.now, 2), None, empty.value.moments),
        critics=Trained(tiny.filled(shape.critics.now, 3), tiny.filled(shape.critics.slow, 4), empty.critics.moments),
        reward_scale=tiny.floats(learner.reward_scale),
    )


def _batch():
    """Rows of which one action lies on its bound."""
    batch = tiny.batch()
    return dataclasses.replace(batch, actions=batch.actions.at[0, 0].set(1.0))


def _cut(batch) -> np.ndarray:
    return np.clip(np.asarray(batch.actions, np.float64), -0.99999, 0.99999)


def _lowest(state, batch) -> np.ndarray:
    return networks.q_values(CriticEnsemble(state.critics.slow), batch.observations, _cut(batch)).min(axis=0)


def _value_loss(value, observations, lowest, expectile: float) -> float:
    total = 0.0
    for v, q in zip(networks.mlp(value, observations)[:, 0], lowest, strict=True):
        total += (expectile if q >= v else 1.0 - expectile) * (q - v) ** 2
    return total / len(lowest)


def _gaussian_loss(actor, observations, actions, weights) -> float:
    mean = np.tanh(networks.mlp(actor.network, observations))
    std = np.exp(np.minimum(np.maximum(networks.numbers(actor.log_std), -5.0), 2.0))
    density = np.sum(stats.norm.logpdf(networks.numbers(actions), mean, std), axis=1)
    return float(-np.mean(weights * density))


def _mean_action_loss(actor, observations, actions, weights) -> float:
    mode = np.tanh(networks.mlp(actor.network, observations))
    return float(np.mean(weights * np.sum((mode - networks.numbers(actions)) ** 2, axis=1)))


@pytest.mark.parametrize("expectile", [0.7, 0.9])
def test_the_value_climbs_by_the_expectile_and_nothing_else_gets_a_gradient(expectile):
    with tiny.exactly():
        state, batch = _state(), tiny.batch()
        lowest, value = _lowest(state, batch), state.value.now
        v = networks.mlp(value, batch.observations)[:, 0]
        lowest[0], lowest[1] = v[0] - 1.0, v[1] + 1.0  # both sides
        given = (batch.observations, tiny.floats(lowest), expectile)
        loss, gradient = jax.value_and_grad(value_loss)(value, *given)
        np.testing.assert_allclose(loss, _value_loss(value, batch.observations, lowest, expectile), rtol=1e-9)
        tiny.assert_slopes(gradient, lambda moved: _value_loss(moved, batch.observations, lowest, expectile), value)
        assert tiny.all_zero(jax.grad(lambda q: value_loss(value, batch.observations, q, expectile))(given[1]))


@pytest.mark.parametrize(("learner", "golden"), [(LEARNER, _gaussian_loss), (MEAN_ACTION, _mean_action_loss)])
def test_the_actor_clones_by_constant_weights(learner, golden):
    with tiny.exactly():
        actor, batch = _state(learner).actor.now, tiny.batch()
        weights = np.linspace(0.2, 3.0, tiny.ROWS)
        loss, gradient = jax.value_and_grad(actor_loss)(actor, batch, tiny.floats(weights))
        np.testing.assert_allclose(loss, golden(actor, batch.observations, batch.actions, weights), rtol=1e-9)
        tiny.assert_slopes(gradient, lambda moved: golden(moved, batch.observations, batch.actions, weights), actor)
        assert tiny.all_zero(jax.grad(lambda w: actor_loss(actor, batch, w))(tiny.floats(weights)))


def test_weights_rise_with_the_advantage_up_to_the_cap_a_row_and_are_constants():
    advantages = jnp.asarray([-2.0, 0.0, 1.0, 5.0, 500.0])
    found = cloning_weights(advantages, 3.0, 100.0)
    np.testing.assert_allclose(found, [np.exp(-6.0), 1.0, np.exp(3.0), 100.0, 100.0], rtol=1e-5)
    assert tiny.all_zero(jax.grad(lambda a: jnp.sum(cloning_weights(a, 3.0, 100.0)))(advantages))


def test_the_actor_and_the_critics_learn_from_the_new_value_and_the_slow_critics():
    with tiny.exactly():
        state, batch = _state(), _batch()
        one, metrics = LEARNER.update(state, batch, jr.key(1))
        lowest, new = _lowest(state, batch), one.value.now
        np.testing.assert_allclose(
            metrics["value/loss"], _value_loss(state.value.now, batch.observations, lowest, 0.7), rtol=1e-9
        )
        advantages = lowest - networks.mlp(new, batch.observations)[:, 0]
        weights = np.minimum(np.exp(3.0 * advantages), 100.0)
        loss = _gaussian_loss(state.actor.now, batch.observations, _cut(batch), weights)
        np.testing.assert_allclose(metrics["actor/loss"], loss, rtol=1e-8)
        np.testing.assert_allclose(metrics["actor/weight"], weights.mean(), rtol=1e-8)
        np.testing.assert_allclose(metrics["actor/capped"], np.mean(weights >= 100.0), rtol=1e-9)
        np.testing.assert_allclose(metrics["value/advantage"], 2.0 * advantages.mean(), rtol=1e-8)  # in logged units

        ends = networks.numbers(batch.terminated)
        assert 0.0 < ends.mean() < 1.0
        after = networks.mlp(new, batch.next_observations)[:, 0]
        y = 0.5 * (networks.numbers(batch.rewards) - 1.0) + 0.9 * (1.0 - ends) * after
        values = networks.q_values(CriticEnsemble(state.critics.now), batch.observations, _cut(batch))
        np.testing.assert_allclose(metrics["critic/loss"], np.sum(np.mean((values - y) ** 2, axis=1)), rtol=1e-8)
        np.testing.assert_allclose(metrics["target/mean"], 2.0 * y.mean(), rtol=1e-8)
        np.testing.assert_allclose(metrics["critic/max"], 2.0 * values.max(), rtol=1e-8)
    expected = jax.tree.map(
        lambda s, n: 0.75 * np.asarray(s) + 0.25 * np.asarray(n), state.critics.slow, one.critics.now
    )
    tiny.assert_close(one.critics.slow, expected, atol=1e-9)
    assert tiny.each_nonzero(jax.tree.map(lambda a, b: np.asarray(a) - np.asarray(b), state.value.now, one.value.now))
    assert one.actor.slow is None and one.value.slow is None


@pytest.mark.parametrize(("done", "share"), [(0, 1.0), (250, 0.5 + 0.5**1.5), (500, 0.5), (1000, 0.0), (1500, 0.0)])
def test_the_actors_step_falls_along_half_a_cosine_and_stays_at_its_end(done, share):
    learner = dataclasses.replace(LEARNER, actor_decay_updates=1000)
    with tiny.exactly():
        np.testing.assert_allclose(learner.actor_rate(jnp.asarray(done)), 1e-2 * share, rtol=1e-9, atol=1e-12)
        assert dataclasses.replace(LEARNER, actor_decay_updates=0).actor_rate(jnp.asarray(done)) == 1e-2


def test_at_the_end_of_the_fall_the_actor_rests_and_the_others_go_on():
    learner = dataclasses.replace(LEARNER, actor_decay_updates=2)
    with tiny.exactly():
        state = dataclasses.replace(_state(), step=jnp.asarray(2))
        one, _ = learner.update(state, tiny.batch(), jr.key(1))
    tiny.assert_close(one.actor.now, state.actor.now, atol=1e-12)
    assert not np.array_equal(one.value.now.weights[0], state.value.now.weights[0])


def test_the_gaussian_acts_by_its_mean_draws_inside_the_bounds_and_keeps_its_spread_in_range():
    with tiny.exactly():
        actor = _state().actor.now
        assert isinstance(actor, UnsquashedGaussianActor)
        wide = dataclasses.replace(actor, log_std=tiny.floats([-9.0, 1.0]))
        rows = tiny.batch(400).observations
        mean, log_std = wide.parameters(rows)
        np.testing.assert_array_equal(log_std[0], [-5.0, 1.0])
        np.testing.assert_allclose(wide.mode(rows), np.tanh(networks.mlp(actor.network, rows)), rtol=1e-9)
        with tiny.recorded() as noise:
            drawn, _ = wide.act((), rows, jr.key(0))
        np.testing.assert_allclose(drawn, np.clip(mean + np.exp([-5.0, 1.0]) * noise[0], -1.0, 1.0), rtol=1e-9)
        assert 0.3 < np.mean(np.abs(np.asarray(drawn)[:, 1]) == 1.0) < 1.0


def test_networks_begin_orthogonal_with_a_gain_and_slow_critics_that_equal_the_critics():
    state = LEARNER.init(jr.key(0), tiny.SPEC, ())
    actor = state.actor.now
    assert isinstance(actor, UnsquashedGaussianActor)
    for weight in (*state.value.now.weights, *actor.network.weights, *state.critics.now.weights):
        for matrix in np.asarray(weight, np.float64).reshape(-1, *weight.shape[-2:]):
            tall = matrix if matrix.shape[0] >= matrix.shape[1] else matrix.T
            np.testing.assert_allclose(tall.T @ tall, 2.0 * np.eye(tall.shape[1]), atol=1e-5)
    first, second = state.critics.now.weights[0]
    assert not np.array_equal(first, second)
    tiny.assert_same_bits(state.critics.now, state.critics.slow)
    assert all(not np.any(bias) for bias in state.value.now.biases) and not np.any(actor.log_std)
    assert isinstance(MEAN_ACTION.init(jr.key(0), tiny.SPEC, ()).actor.now, DeterministicActor)


def test_returns_of_the_log_span_a_thousand_after_the_shift():
    chain, last = np.random.default_rng(0).normal(size=(13, 3)), np.isin(np.arange(12), [3, 11])
    log = Dataset.from_arrays(
        chain[:-1], np.zeros((12, 2)), chain[:-1, 0], next_observations=chain[1:], truncated=last,
        action_bounds=(-1.0, 1.0),
    )  # fmt: skip
    assert log.episode_lengths().tolist() == [4, 8]  # so that the shift tells
    returns = [sum(log.rewards[log.episode(index)] - 1.0) for index in range(log.num_episodes)]
    learner = dataclasses.replace(LEARNER, reward_scale="returns")
    normaliser = Normaliser.identity(3)
    factor, report = learner.pretrain(log, normaliser, jr.key(0), lambda *_: None)
    np.testing.assert_allclose((max(returns) - min(returns)) * float(factor), 1000.0, rtol=1e-5)
    np.testing.assert_allclose(report["reward_scale"], float(factor), rtol=1e-6)
    assert float(learner.init(jr.key(0), log.spec(), factor).reward_scale) == float(factor)
    level = Dataset.from_arrays(
        log.observations, log.actions, np.ones(len(log)), next_observations=log.next_observations,
        truncated=np.arange(12) % 4 == 3, action_bounds=(-1.0, 1.0),
    )  # fmt: skip
    with pytest.raises(ConfigError, match="every episode of the log returns .*reward_scale=1.0"):
        learner.pretrain(level, normaliser, jr.key(0), lambda *_: None)


def test_shifted_rewards_shift_the_values_that_the_monitor_allows():
    spec = dataclasses.replace(tiny.SPEC, reward_min=0.0, reward_max=1.0)
    assert value_bounds(spec, 0.99, -1.0) == pytest.approx((-100.0, 0.0))
    seen = {"critic/max": 0.0, "critic/min": -99.0}
    assert DivergenceMonitor(spec, 0.99, {"reward_shift": -1.0}).observe(1, seen) == []
    assert [found.kind for found in DivergenceMonitor(spec, 0.99, {}).observe(1, seen)] == ["below-range"]


def test_presets_are_as_published():
    locomotion, maze = presets.load("iql", task="hopper-medium"), presets.load("iql", task="antmaze-large-play")
    assert (locomotion.expectile, locomotion.inverse_temperature, locomotion.reward_scale) == (0.7, 3.0, "returns")
    assert (maze.expectile, maze.inverse_temperature, maze.reward_scale, maze.reward_shift) == (0.9, 10.0, 1.0, -1.0)
    assert len(presets.tasks("iql")) == 21
    corl = {task: presets.load("iql-corl", task=task) for task in presets.tasks("iql-corl")}
    assert set(corl) == set(presets.tasks("iql"))
    best = corl["hopper-medium-expert"]
    assert (best.expectile, best.inverse_temperature, best.reward_scale) == (0.5, 6.0, 1.0)
    replay = corl["hopper-medium-replay"]
    assert (replay.actor_kind, replay.target_rate, replay.reward_scale) == ("deterministic", 1e-3, "returns")
    assert corl["walker2d-medium"] == presets.load("iql-corl") and corl["walker2d-medium"].reward_scale == 1.0


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("discount", 1.0),
        ("expectile", 1.0),
        ("target_rate", 0.0),
        ("reward_scale", 0.0),
        ("weight_cap", 0.0),
        ("batch_size", 0),
        ("inverse_temperature", -1.0),
    ],
)
def test_impossible_settings_are_named(field, value):
    with pytest.raises(ConfigError, match=field):
        IQL(**{field: value})
