"""Truncated quantile critics against their equations, by hand and in NumPy, and one update against its parts."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import tiny
from golden import truncated_quantiles as golden
from odaf.algorithms.truncated_quantile_critics import (
    TQCState,
    TruncatedQuantileCritics,
    mean_critics,
    quantile_huber_loss,
    without_largest,
)
from odaf.components.trained import Trained
from odaf.errors import ConfigError

LEARNER = TruncatedQuantileCritics(
    num_critics=2, num_quantiles=4, dropped=1, hidden_sizes=(5, 4), batch_size=tiny.ROWS, discount=0.9
)


def state_of(learner: TruncatedQuantileCritics = LEARNER, size: float = 0.6) -> TQCState:
    """A state at step 0 with random networks and a temperature of a half."""
    shape = eqx.filter_eval_shape(lambda: learner.init(jr.key(0), tiny.SPEC, ()))
    empty = tiny.filled(shape, size=0.0)
    return dataclasses.replace(
        empty,
        actor=Trained(tiny.filled(shape.actor.now, 1, size), None, empty.actor.moments),
        critics=Trained(
            tiny.filled(shape.critics.now, 2, size), tiny.filled(shape.critics.slow, 3, size), empty.critics.moments
        ),
        log_temperature=Trained(tiny.floats(np.log(0.5)), None, empty.log_temperature.moments),
    )


def test_truncation_by_hand():
    """Two largest of four go; in the second row the two equal fives, the earlier one first."""
    atoms = jnp.asarray([[1.0, 5.0], [7.0, 3.0], [9.0, 5.0], [-2.0, 4.0]])
    one = [[True, False], [True, True], [False, True], [True, True]]
    two = [[True, False], [False, True], [False, False], [True, True]]
    np.testing.assert_array_equal(without_largest(atoms, 1), one)
    np.testing.assert_array_equal(without_largest(atoms, 2), two)
    np.testing.assert_array_equal(without_largest(atoms, 0), np.ones((4, 2), bool))


def test_truncation_keeps_the_same_number_in_every_row_even_where_all_atoms_are_equal():
    assert np.asarray(without_largest(jnp.zeros((6, 3)), 4)).sum(axis=0).tolist() == [2, 2, 2]


def test_quantile_loss_by_hand():
    """One row, two quantiles (levels 1/4 and 3/4), kept atoms 0.5 and 3, a dropped atom 100.

    theta_1 = 0: errors 0.5 and 3, weights 1/4: (0.125 + 2.5) / 4. theta_2 = 1: errors -0.5 (weight 1/4) and 2 (weight
    3/4): 0.125 / 4 + 1.5 * 3 / 4. Mean over the four pairs.
    """
    by_hand = ((0.125 + 2.5) / 4 + 0.125 / 4 + 1.5 * 3 / 4) / 4
    column = [[0.5], [100.0], [3.0]]
    loss = quantile_huber_loss(jnp.asarray([[0.0], [1.0]]), jnp.asarray(column), jnp.asarray([[True], [False], [True]]))
    np.testing.assert_allclose(loss, [by_hand], rtol=1e-6)


def test_target_critic_loss_and_gradients_agree_with_numpy():
    with tiny.exactly():
        state, batch = state_of(), tiny.batch()
        with tiny.recorded() as drawn:
            targets, kept = LEARNER.target(state, batch, jr.key(5))
        rows = golden.targets(state, batch, drawn[0], 0.9, dropped=1)
        for row, expected in enumerate(rows):
            found = np.sort(np.asarray(targets)[np.asarray(kept)[:, row], row])
            np.testing.assert_allclose(found, np.sort(expected), rtol=1e-9)

        gradient, metrics = LEARNER.critic_gradient(state, batch, jr.key(5))
        np.testing.assert_allclose(
            metrics["critic/loss"], golden.critic_loss(state.critics.now, batch, rows), rtol=1e-9
        )
        tiny.assert_slopes(gradient, lambda critics: golden.critic_loss(critics, batch, rows), state.critics.now)


def test_actor_loss_and_gradient_agree_with_numpy():
    with tiny.exactly():
        state, batch = state_of(), tiny.batch()
        with tiny.recorded() as drawn:
            loss, log_density = LEARNER.actor_loss(state.actor.now, state, batch, jr.key(5))
        expected = golden.actor_loss(state.actor.now, state.critics.now, state.log_temperature.now, batch, drawn[0])
        np.testing.assert_allclose(loss, expected, rtol=1e-9)
        assert log_density.shape == (tiny.ROWS,)
        gradient = jax.grad(lambda actor: LEARNER.actor_loss(actor, state, batch, jr.key(5))[0])(state.actor.now)
        tiny.assert_slopes(
            gradient,
            lambda actor: golden.actor_loss(actor, state.critics.now, state.log_temperature.now, batch, drawn[0]),
            state.actor.now,
        )


def test_the_averaged_last_layer_is_the_mean_of_the_quantiles():
    with tiny.exactly():
        state, batch = state_of(), tiny.batch()
        expected = golden.quantiles(state.critics.now, batch.observations, batch.actions).mean(axis=2)
        np.testing.assert_allclose(
            mean_critics(state.critics.now)(batch.observations, batch.actions), expected, rtol=1e-9
        )


def test_targets_receive_no_gradient():
    predicted, atoms = jnp.asarray([[0.0], [1.0]]), jnp.asarray([[0.5], [3.0]])
    kept = jnp.ones((2, 1), bool)
    slope = jax.grad(lambda y: jnp.sum(quantile_huber_loss(predicted, y, kept)))(atoms)
    assert tiny.all_zero(slope)


def test_an_update_moves_everything_once_and_the_same_key_gives_the_same_bits():
    state, batch = LEARNER.init(jr.key(1), tiny.SPEC), tiny.batch()
    update = jax.jit(LEARNER.update)
    new, metrics = update(state, batch, jr.key(2))
    again, _ = update(state, batch, jr.key(2))
    tiny.assert_same_bits(new, again)
    assert int(new.step) == 1 and all(np.isfinite(value) for value in metrics.values())
    for before, after in ((state.actor.now, new.actor.now), (state.critics.now, new.critics.now)):
        changes = jax.tree.map(lambda a, b: np.abs(np.asarray(a) - np.asarray(b)).max(), before, after)
        assert max(jax.tree.leaves(changes)) > 1e-5
    slow = jax.tree.map(lambda old, online: 0.995 * old + 0.005 * online, state.critics.slow, new.critics.now)
    for expected, found in zip(jax.tree.leaves(slow), jax.tree.leaves(new.critics.slow), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-7)


def test_it_learns_the_quantiles_of_a_reward_that_is_a_coin():
    """One state, no future: half of the rewards are 0, half are 4. Quantiles of level below a half settle at 0, those
    above at 4, each within Huber's blur; the truncated target does not matter since all atoms of a row are equal."""
    learner = dataclasses.replace(LEARNER, learning_rate=1e-2, batch_size=64, initial_temperature=1e-6)
    state = learner.init(jr.key(0), tiny.SPEC)
    rewards = np.resize([0.0, 4.0], 64)
    batch = dataclasses.replace(
        tiny.batch(64),
        observations=jnp.zeros((64, tiny.OBS_DIM)),
        actions=jnp.zeros((64, tiny.ACT_DIM)),
        rewards=tiny.floats(rewards),
        terminated=jnp.ones(64),
    )

    @jax.jit
    def train(state):
        return jax.lax.scan(lambda s, key: (learner.update(s, batch, key)[0], None), state, jr.split(jr.key(1), 600))[0]

    found = golden.quantiles(train(state).critics.now, batch.observations[:1], batch.actions[:1])[:, 0]
    # A prediction t above 0 rests where (1 - tau) t, the pull of the zeros, equals tau, the pull of the far fours:
    # t = 1/7 and 3/5 for the levels 1/8 and 3/8, and by symmetry as far below 4 for 7/8 and 5/8.
    np.testing.assert_allclose(found, [[1 / 7, 3 / 5, 4 - 3 / 5, 4 - 1 / 7]] * 2, atol=0.03)


@pytest.mark.parametrize(
    ("field", "value"),
    [("discount", 1.0), ("target_rate", 0.0), ("dropped", 25), ("batch_size", 0), ("initial_temperature", 0.0)],
)
def test_impossible_settings_are_named(field, value):
    with pytest.raises(ConfigError, match=field):
        TruncatedQuantileCritics(**{field: value})
