"""The policy that is asked for a return: what it sees, what it counts, and where it is cut."""

import dataclasses

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import networks, tiny
from odaf.components.networks import init_mlp
from odaf.components.return_conditioned import ReturnConditionedActor
from odaf.data.normalisation import Normaliser
from odaf.errors import DatasetError
from odaf.training.policy import Policy


def _actor() -> ReturnConditionedActor:
    network = tiny.filled(jax.eval_shape(lambda: init_mlp(jr.key(0), (tiny.OBS_DIM + 1, 5, tiny.ACT_DIM))), 1, 1.0)
    return ReturnConditionedActor(network, tiny.floats(10.0), tiny.floats(8.0), tiny.floats(4.0))


def test_it_sees_what_is_left_and_is_cut_only_where_it_acts():
    with tiny.exactly():
        actor, rows = _actor(), tiny.batch().observations
        asked = (np.linspace(0.0, 20.0, tiny.ROWS) - 8.0) / 4.0
        expected = networks.mlp(actor.network, np.concatenate([networks.numbers(rows), asked[:, None]], axis=1))
        returns = tiny.floats(np.linspace(0.0, 20.0, tiny.ROWS))
        np.testing.assert_allclose(actor.actions(rows, returns), expected, rtol=1e-9)
        actions, carry = actor.act(returns, rows)
    assert np.abs(expected).max() > 1.0 > np.abs(expected).min()
    np.testing.assert_allclose(actions, np.clip(expected, -1, 1), rtol=1e-9)
    np.testing.assert_array_equal(carry, returns)


def test_a_policy_counts_the_rewards_of_each_episode_without_a_discount():
    actor = _actor()
    policy = Policy(actor, Normaliser(np.zeros(3), np.ones(3)), (-2.0, -2.0), (2.0, 2.0), ("a", "b", "c"))
    assert policy.has_memory
    rows, carry = np.zeros((2, 3), np.float32), policy.begin(2)
    for rewards in ([1.0, -2.0], [0.5, 3.0], [0.25, 0.0]):
        _, carry = policy.act(carry, rows)
        carry = policy.observe(carry, rewards)
    np.testing.assert_allclose(carry, [10.0 - 1.75, 10.0 - 1.0], rtol=1e-6)
    actions, _ = policy.act(carry, rows)
    alone = dataclasses.replace(policy, actor=dataclasses.replace(actor, start=jnp.asarray(8.25)))
    np.testing.assert_allclose(actions[0], alone.act(alone.begin(), rows[0])[0], rtol=1e-5)
    assert not np.allclose(actions[0], actions[1])
    for wrong in (1.0, [1.0, 2.0, 3.0], np.ones((2, 1))):
        with pytest.raises(DatasetError, match=r"reward: has shape \(.*\), not \(2,\)"):
            policy.observe(carry, wrong)
    with pytest.raises(DatasetError, match="reward: is not a finite number"):
        policy.observe(carry, [1.0, np.nan])
