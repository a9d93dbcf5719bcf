"""CQL against its formulas in float64 NumPy, action by action; the order of its steps is that of public codes."""

import dataclasses
import typing

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import networks, tiny
from odaf.algorithms.cql import CQL, CQLState
from odaf.components import chunks
from odaf.components.conservative import SoftMaximum, soft_maximum
from odaf.components.critics import CriticEnsemble
from odaf.components.trained import Trained
from odaf.errors import ConfigError
from odaf.runs import presets

WIDTHS = {"actor_hidden_sizes": (5, 4), "critic_hidden_sizes": (5, 4), "batch_size": tiny.ROWS}
LEARNER = CQL(
    **WIDTHS,
    conservative_weight=5.0,
    num_actions=3,
    penalty_temperature=0.5,
    discount=0.9,
    reward_scale=10.0,
    reward_shift=-0.5,
    target_rate=0.25,
)
KEY = 7


def _state(learner: CQL = LEARNER) -> CQLState:
    """Different random networks and a temperature of a half."""
    shape = jax.eval_shape(lambda: learner.init(jr.key(0), tiny.SPEC, ()))
    empty = tiny.filled(shape, size=0.0)
    dual = empty.log_multiplier
    return dataclasses.replace(
        empty,
        actor=Trained(tiny.filled(shape.actor.now, 1), None, empty.actor.moments),
        critics=Trained(tiny.filled(shape.critics.now, 3), tiny.filled(shape.critics.slow, 4), empty.critics.moments),
        log_temperature=Trained(tiny.floats(np.log(0.5)), None, empty.log_temperature.moments),
        log_multiplier=None if dual is None else Trained(tiny.floats(1.0), None, dual.moments),
        reward_scale=tiny.floats(learner.reward_scale),
    )


def _act(actor, observations, noise) -> tuple[np.ndarray, np.ndarray]:
    """tanh of the Gaussian and its density by the change of variables, without a floor."""
    mean, output = np.split(networks.mlp(actor.network, observations), 2, axis=1)
    scale, offset = networks.numbers(actor.log_std_scale), networks.numbers(actor.log_std_offset)
    std = np.exp(np.minimum(np.maximum(scale * output + offset, -20.0), 2.0))
    z = mean + std * networks.numbers(noise)
    density = np.exp(-0.5 * ((z - mean) / std) ** 2) / (std * np.sqrt(2.0 * np.pi) * (1.0 - np.tanh(z) ** 2))
    return np.tanh(z), np.sum(np.log(density), axis=1)


def _loss(learner, critics, state, batch, drawn, uniform) -> tuple[float, float, float]:
    """L_Q, the critics' mean penalty and mean gap, row by row; `drawn` is a', then the noise at s and at s'."""
    target, here, following = drawn
    slow = CriticEnsemble(state.critics.slow)
    options = [_act(state.actor.now, batch.next_observations, one)[0] for one in target]
    after = np.max([networks.q_values(slow, batch.next_observations, a).min(axis=0) for a in options], axis=0)
    alive = 1.0 - networks.numbers(batch.terminated)
    y = 10.0 * (networks.numbers(batch.rewards) - 0.5) + 0.9 * alive * after

    sources = [[(networks.numbers(u), np.full(len(u), np.log(0.5 ** u.shape[1]))) for u in uniform]]
    sources.append([_act(state.actor.now, batch.next_observations, one) for one in following])
    sources.append([_act(state.actor.now, batch.observations, one) for one in here])
    valued = [[(networks.q_values(critics, batch.observations, a), d) for a, d in source] for source in sources]
    logged = networks.q_values(critics, batch.observations, batch.actions)
    t, total, penalties, all_gaps = learner.penalty_temperature, 0.0, [], []
    for k in range(2):
        gaps = []
        for row in range(tiny.ROWS):
            terms = np.array([[np.exp((q[k, row] - d[row]) / t) for q, d in source] for source in valued])
            soft = np.log(terms.sum()) if learner.soft_maximum == "all" else np.log(terms.sum(axis=0)).mean()
            gaps.append(t * soft - logged[k, row])
        all_gaps += gaps
        low, high = learner.gap_min, learner.gap_max
        cut = [max(gap, -np.inf if low is None else low) for gap in gaps]
        cut = [min(gap, np.inf if high is None else high) for gap in cut]
        penalties.append(learner.conservative_weight * (np.mean(cut) - (learner.lagrange_gap or 0.0)))
        eta = 1.0 if learner.lagrange_gap is None else np.exp(float(state.log_multiplier.now))
        total += np.mean((logged[k] - y) ** 2) + eta * penalties[-1]
    return float(total), float(np.mean(penalties)), float(np.mean(all_gaps))


VARIANTS = {
    "plain": LEARNER,
    "threes": dataclasses.replace(LEARNER, soft_maximum="threes"),
    "mazes": dataclasses.replace(LEARNER, lagrange_gap=0.8, gap_min=2.35, gap_max=2.5, backup_actions=4),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_the_critics_follow_their_formula(name, monkeypatch):
    learner = VARIANTS[name]
    monkeypatch.setattr(chunks, "ROWS_AT_ONCE", 25)  # 10 actions a state: two states at a time, three times
    with tiny.exactly():
        state, batch = _state(learner), tiny.batch()
        with tiny.recorded() as drawn, tiny.recorded("uniform") as uniform:
            gradient, penalty, metrics = learner.critic_gradient(state, batch, jr.key(KEY))
        given = (state, batch, drawn, uniform[0])

        def expected(networks_now):
            return _loss(learner, CriticEnsemble(networks_now), *given)[0]

        tiny.assert_slopes(gradient, expected, state.critics.now)
        _, wanted, gap = _loss(learner, CriticEnsemble(state.critics.now), *given)
        np.testing.assert_allclose(penalty, wanted, rtol=1e-9)
        np.testing.assert_allclose(metrics["conservative/gap"], gap, rtol=1e-9)
        if name == "mazes":  # bounds cut some rows, not all of them and not their mean
            assert not np.isclose(wanted, 5.0 * (gap - 0.8)) and tiny.each_nonzero(gradient)


def test_the_soft_maximum_weighs_by_constant_densities():
    with tiny.exactly():
        values, density = tiny.floats(np.arange(12.0).reshape(6, 2) / 5.0), tiny.floats(np.ones((6, 2)))
        for over in typing.get_args(SoftMaximum):
            slopes = jax.grad(lambda v, d, o=over: jnp.sum(soft_maximum(v, d, 1.0, o)), argnums=(0, 1))(values, density)
            np.testing.assert_allclose(np.sum(slopes[0], axis=0), 1.0, rtol=1e-12)
            assert tiny.all_zero(slopes[1])


@pytest.mark.parametrize("cloning_updates", [0, 3])
def test_the_actor_climbs_the_lower_critic_and_clones_first_where_asked(cloning_updates):
    learner = dataclasses.replace(LEARNER, cloning_updates=cloning_updates)
    with tiny.exactly():
        batch = tiny.batch()
        for step in (0, 3):
            state = dataclasses.replace(_state(), step=jnp.asarray(step))
            with tiny.recorded() as drawn:
                loss, _ = learner.actor_loss(state.actor.now, state, batch, jr.key(KEY))
            gradient = jax.grad(lambda a, s=state: learner.actor_loss(a, s, batch, jr.key(KEY))[0])(state.actor.now)

            def expected(actor, state=state, step=step, noise=drawn[0]):
                actions, density = _act(actor, batch.observations, noise)
                values = networks.q_values(CriticEnsemble(state.critics.now), batch.observations, actions).min(axis=0)
                if step < cloning_updates:
                    logged = np.clip(networks.numbers(batch.actions), -0.999, 0.999)
                    back = np.arctanh(logged)
                    mean, output = np.split(networks.mlp(actor.network, batch.observations), 2, axis=1)
                    std = np.exp(np.maximum(
                        np.minimum(float(actor.log_std_scale) * output + float(actor.log_std_offset), 2.0), -20.0
                    ))  # fmt: skip
                    normal = -0.5 * ((back - mean) / std) ** 2 - np.log(std * np.sqrt(2.0 * np.pi))
                    values = np.sum(normal - np.log(1.0 - logged**2), axis=1)
                return float(np.mean(0.5 * density - values))

            np.testing.assert_allclose(loss, expected(state.actor.now), rtol=1e-9)
            tiny.assert_slopes(gradient, expected, state.actor.now)


def test_everything_steps_from_the_parameters_before_and_the_multiplier_climbs_while_the_gap_is_wide():
    wide, narrow = (dataclasses.replace(LEARNER, lagrange_gap=gap) for gap in (-50.0, 50.0))
    with tiny.exactly():
        state, batch = _state(wide), tiny.batch()
        one, metrics = wide.update(state, batch, jr.key(KEY))
        other, _ = narrow.update(state, batch, jr.key(KEY))
        _, key_critic = jr.split(jr.key(KEY))
        gradient, _, _ = wide.critic_gradient(state, batch, key_critic)
        critics = state.critics.stepped(gradient, wide.critic_learning_rate, wide.target_rate)
    assert one.log_multiplier is not None and other.log_multiplier is not None
    np.testing.assert_allclose(one.log_multiplier.now, 1.0 + 3e-4, rtol=1e-6)
    np.testing.assert_allclose(other.log_multiplier.now, 1.0 - 3e-4, rtol=1e-6)
    np.testing.assert_allclose(metrics["conservative/multiplier"], np.exp(1.0 + 3e-4), rtol=1e-6)
    tiny.assert_close(one.critics.now, critics.now, atol=1e-12)
    expected = jax.tree.map(
        lambda s, n: 0.75 * np.asarray(s) + 0.25 * np.asarray(n), state.critics.slow, one.critics.now
    )
    tiny.assert_close(one.critics.slow, expected, atol=1e-9)


def test_it_begins_as_published():
    learner = dataclasses.replace(LEARNER, initial_log_std_scale=0.0, lagrange_gap=0.2)
    state = learner.init(jr.key(0), tiny.SPEC, ())
    first, *_, last = state.critics.now.weights
    for matrix, gain in ((first[0], 2.0), (last[1].T, 1e-4)):
        wide = np.asarray(matrix, np.float64)
        wide = wide if wide.shape[0] <= wide.shape[1] else wide.T
        np.testing.assert_allclose(wide @ wide.T, gain * np.eye(len(wide)), atol=1e-5)
    tiny.assert_same_bits(state.critics.now, state.critics.slow)
    head = state.actor.now.network
    assert np.abs(head.weights[-1]).max() <= 0.01 * np.sqrt(6.0 / (4 + 4)) and not np.any(head.biases[-1])
    _, log_std = state.actor.now.parameters(jnp.ones((2, tiny.OBS_DIM)))
    np.testing.assert_array_equal(log_std, -np.ones((2, 2)))
    assert state.log_multiplier is not None and float(state.log_multiplier.now) == 1.0


def test_presets_are_as_published():
    base = presets.load("cql")
    assert isinstance(base, CQL) and (base.conservative_weight, base.lagrange_gap) == (10.0, None)
    assert (base.actor_learning_rate, base.critic_learning_rate) == (3e-5, 3e-4)
    assert presets.load("cql", task="hopper-medium").reward_scale == "returns"
    assert presets.load("cql", task="walker2d-expert") == base
    maze = presets.load("cql", task="antmaze-large-play")
    assert isinstance(maze, CQL) and (maze.conservative_weight, maze.lagrange_gap, maze.gap_min) == (5.0, 0.8, -200.0)
    assert (maze.backup_actions, maze.actor_learning_rate) == (10, 1e-4)
    assert (len(maze.critic_hidden_sizes), len(maze.actor_hidden_sizes)) == (5, 3)
    assert (maze.reward_scale, maze.reward_shift) == (10.0, -0.5)  # 10 r - 5
    assert len(presets.tasks("cql")) == 21
    other = presets.load("cql-young-geng", task="antmaze-medium-diverse")
    assert isinstance(other, CQL) and (other.lagrange_gap, other.gap_min) == (0.2, -200.0)
    assert other.cloning_updates == 40_000
    assert (len(other.critic_hidden_sizes), len(other.actor_hidden_sizes)) == (3, 2)
    assert (other.actor_learning_rate, other.initial_log_std_scale, other.reward_shift) == (1e-4, 0.0, -0.5)
    assert presets.load("cql-young-geng", task="hopper-medium") == presets.load("cql-young-geng")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("discount", 1.0),
        ("target_rate", 0.0),
        ("reward_scale", 0.0),
        ("penalty_temperature", 0.0),
        ("num_actions", 0),
        ("backup_actions", 0),
        ("conservative_weight", -1.0),
    ],
)
def test_impossible_settings_are_named(field, value):
    with pytest.raises(ConfigError, match=field):
        CQL(**{field: value})


def test_bounds_of_the_gap_must_leave_room():
    with pytest.raises(ConfigError, match="gap_min=3.0 must be below gap_max=2.0"):
        CQL(gap_min=3.0, gap_max=2.0)
