"""ReBRAC against its formulas, in float64 NumPy."""

import dataclasses

import jax
import jax.random as jr
import numpy as np
import pytest

from battery import learners
from golden import networks, tiny
from odaf.algorithms.rebrac import ReBRAC, actor_loss
from odaf.components.critics import CriticEnsemble
from odaf.data.normalisation import Normaliser
from odaf.data.sampling import training_columns
from odaf.data.transitions import Transitions
from odaf.errors import ConfigError
from odaf.runs import presets

LEARNER = ReBRAC(
    hidden_sizes=(5, 4),
    batch_size=tiny.ROWS,
    actor_penalty=0.3,
    critic_penalty=0.7,
    discount=0.9,
    reward_scale=2.0,
    target_rate=0.25,
    actor_learning_rate=1e-2,
    critic_learning_rate=2e-2,
)


def _batch() -> Transitions:
    """Rows 2 and 5 truly end; row 4 is cut by a time limit, so no action follows it either."""
    batch = tiny.batch()
    followed = np.array([1.0, 1.0, 0.0, 1.0, 0.0, 0.0])
    after = np.random.default_rng(9).uniform(-1.0, 1.0, (tiny.ROWS, tiny.ACT_DIM)) * followed[:, None]
    return dataclasses.replace(batch, extras={"next_actions": tiny.floats(after), "followed": tiny.floats(followed)})


def _mode(actor, observations) -> np.ndarray:
    return np.tanh(networks.mlp(actor.network, observations))


def _target(state, batch, noise) -> np.ndarray:
    actions = np.clip(_mode(state.actor.slow, batch.next_observations) + np.clip(0.2 * noise, -0.5, 0.5), -1.0, 1.0)
    values = networks.q_values(CriticEnsemble(state.critics.slow), batch.next_observations, actions)
    y = []
    for row in range(tiny.ROWS):
        value = min(values[:, row])
        if row in (0, 1, 3):
            value -= 0.7 * sum((actions[row] - networks.numbers(batch.extras["next_actions"])[row]) ** 2)
        y.append(2.0 * float(batch.rewards[row]) + (0.0 if row in (2, 5) else 0.9 * value))
    return np.array(y)


def _lowest(actor, critics, batch) -> np.ndarray:
    return networks.q_values(critics, batch.observations, _mode(actor, batch.observations)).min(axis=0)


def _actor_loss(actor, critics, batch, size: float) -> float:
    gaps = _mode(actor, batch.observations) - networks.numbers(batch.actions)
    return float(0.3 * np.mean(np.sum(gaps**2, axis=1)) - np.mean(_lowest(actor, critics, batch)) / size)


def test_the_target_takes_the_distance_from_the_logged_next_action_off_where_there_is_one():
    with tiny.exactly():
        state, batch = tiny.twin_delayed_state(dataclasses.replace(LEARNER, num_critics=3)), _batch()
        with tiny.recorded() as drawn:
            y = LEARNER.target(state, batch, jr.key(5))
        np.testing.assert_allclose(y, _target(state, batch, np.asarray(drawn[0])), rtol=1e-9)
        plain = dataclasses.replace(LEARNER, critic_penalty=0.0).target(state, batch, jr.key(5))
        np.testing.assert_array_equal(np.asarray(y) < np.asarray(plain), [True, True, False, True, False, False])
        elsewhere = batch.extras | {"next_actions": batch.extras["next_actions"].at[4].set(0.9)}
        moved = LEARNER.target(state, dataclasses.replace(batch, extras=elsewhere), jr.key(5))
    np.testing.assert_array_equal(moved, y)  # what stands in place of an action that never was counts for nothing


def test_the_actor_is_pulled_to_the_log_and_climbs_the_lower_value_in_units_of_its_size():
    with tiny.exactly():
        state, batch = tiny.twin_delayed_state(LEARNER), _batch()
        actor, critics = state.actor.now, CriticEnsemble(state.critics.now)
        both = networks.q_values(critics, batch.observations, _mode(actor, batch.observations))
        level = tiny.floats([[0.0], [np.median(both[0] - both[1])]])  # brings the second critic to the first one
        *hidden, output = critics.networks.biases
        critics = CriticEnsemble(dataclasses.replace(critics.networks, biases=(*hidden, output + level)))
        both = both + np.asarray(level)
        assert 0 < np.sum(both[0] < both[1]) < tiny.ROWS  # each critic is the lower one somewhere
        size = np.abs(both.min(axis=0)).mean()
        (loss, metrics), gradient = jax.value_and_grad(actor_loss, has_aux=True)(actor, critics, batch, 0.3)
        np.testing.assert_allclose(loss, _actor_loss(actor, critics, batch, size), rtol=1e-9)
        assert set(metrics) == set(state.actor_metrics)
        tiny.assert_slopes(gradient, lambda a: _actor_loss(a, critics, batch, size), actor)  # the size is a constant
        assert tiny.all_zero(jax.grad(lambda c: actor_loss(actor, c, batch, 0.3)[0])(critics))


def test_critics_step_each_time_the_actor_and_all_slow_copies_every_second_and_rates_are_their_own():
    with tiny.exactly():
        state, batch = tiny.twin_delayed_state(LEARNER), _batch()
        with tiny.recorded() as drawn:
            one, first = LEARNER.update(state, batch, jr.key(1))
        two, second = LEARNER.update(one, batch, jr.key(2))
        y = _target(state, batch, np.asarray(drawn[0]))
        values = networks.q_values(CriticEnsemble(state.critics.now), batch.observations, batch.actions)
        np.testing.assert_allclose(first["critic/loss"], np.sum(np.mean((values - y) ** 2, axis=1)), rtol=1e-9)
        np.testing.assert_allclose(first["target/mean"], y.mean() / 2.0, rtol=1e-9)  # in logged units
        lowest = _lowest(one.actor.now, CriticEnsemble(two.critics.now), batch)
        np.testing.assert_allclose(second["actor/value"], lowest.mean() / 2.0, rtol=1e-6)
        loss = _actor_loss(one.actor.now, CriticEnsemble(two.critics.now), batch, np.abs(lowest).mean())
        np.testing.assert_allclose(second["actor/loss"], loss, rtol=1e-6)  # against the new critics
    tiny.assert_same_bits((one.actor, one.critics.slow), (state.actor, state.critics.slow))
    assert float(first["actor/loss"]) == 0.0  # there has been no actor step yet
    for part in ("actor", "critics"):
        before, after = getattr(one, part), getattr(two, part)
        expected = jax.tree.map(lambda s, n: 0.75 * np.asarray(s) + 0.25 * np.asarray(n), before.slow, after.now)
        tiny.assert_close(after.slow, expected, atol=1e-9)
    # Adam's first step has the size of its rate
    for before, after, rate in ((one.actor, two.actor, 1e-2), (state.critics, one.critics, 2e-2)):
        steps = jax.tree.map(lambda a, b: np.abs(np.asarray(a) - np.asarray(b)).max(), before.now, after.now)
        np.testing.assert_allclose(max(jax.tree.leaves(steps)), rate, rtol=1e-3)


def test_only_the_critics_are_normalised():
    state = LEARNER.init(jr.key(0), tiny.SPEC, ())
    assert len(state.critics.now.scales) == 2 and state.actor.now.network.scales == ()
    tiny.assert_same_bits((state.actor.now, state.critics.now), (state.actor.slow, state.critics.slow))


def test_the_columns_hold_the_next_logged_action_and_none_at_an_episodes_last_row():
    log = learners.log()
    columns = training_columns(log, Normaliser.identity(3), LEARNER.view())
    assert isinstance(columns, Transitions)
    last = np.arange(len(log)) % 8 == 7
    np.testing.assert_array_equal(columns.extras["followed"], ~last)
    after = np.roll(np.asarray(columns.actions), -1, axis=0)
    np.testing.assert_array_equal(columns.extras["next_actions"], np.where(last[:, None], 0.0, after))


@pytest.mark.parametrize(
    ("task", "penalties"),
    [
        ("halfcheetah-random", (0.001, 0.1)),
        ("halfcheetah-medium-replay", (0.01, 0.001)),
        ("hopper-medium-replay", (0.05, 0.5)),
        ("hopper-medium-expert", (0.1, 0.01)),
        ("walker2d-random", (0.01, 0.0)),
        ("walker2d-expert", (0.01, 0.5)),
        ("antmaze-medium-play", (0.001, 0.0005)),
        ("antmaze-large-diverse", (0.002, 0.002)),
    ],
)
def test_tasks_are_as_published(task, penalties):
    learner = presets.load("rebrac", task=task)
    assert (learner.actor_penalty, learner.critic_penalty) == penalties
    rest = (learner.actor_learning_rate, learner.critic_learning_rate, learner.batch_size, learner.discount)
    assert rest == ((3e-4, 5e-5, 256, 0.999) if task.startswith("antmaze") else (1e-3, 1e-3, 1024, 0.99))
    assert learner.reward_scale == (100.0 if task.startswith("antmaze") else 1.0)
    assert len(presets.tasks("rebrac")) == 21 and learner.num_critics == 2


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("discount", 1.0),
        ("target_rate", 0.0),
        ("reward_scale", 0.0),
        ("actor_delay", 0),
        ("num_critics", 0),
        ("critic_penalty", -1.0),
    ],
)
def test_impossible_settings_are_named(field, value):
    with pytest.raises(ConfigError, match=field):
        ReBRAC(**{field: value})
