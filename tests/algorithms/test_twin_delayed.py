"""What TD3's relatives with a model of the log share."""

import dataclasses

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import tiny
from odaf.algorithms.scas import SCAS
from odaf.algorithms.spot import SPOT
from odaf.algorithms.svr import SVR
from odaf.components.behaviour_models import BehaviourConfig
from odaf.components.dynamics import DynamicsConfig

SMALL = {
    "hidden_sizes": (5, 4),
    "batch_size": tiny.ROWS,
    "target_rate": 0.25,
    "actor_learning_rate": 1e-2,
    "critic_learning_rate": 2e-2,
}
MODEL = BehaviourConfig(hidden_sizes=(4,))
LEARNERS = [
    SPOT(**SMALL, behaviour=MODEL),
    SVR(**SMALL, behaviour=MODEL, actor_decay_updates=0),
    SCAS(**SMALL, dynamics=DynamicsConfig(hidden_sizes=(4,)), actor_decay_updates=0),
]


@pytest.mark.parametrize("learner", LEARNERS, ids=[learner.kind for learner in LEARNERS])
def test_critics_step_each_time_the_actor_and_all_slow_copies_every_second_and_models_never(learner):
    with tiny.exactly():
        state, batch = tiny.twin_delayed_state(learner), tiny.batch(extras=learner.view().extras)
        one, first = learner.update(state, batch, jr.key(1))
        two, second = learner.update(one, batch, jr.key(2))
    tiny.assert_same_bits((one.actor, one.critics.slow), (state.actor, state.critics.slow))
    tiny.assert_same_bits(two.models, state.models)
    assert float(first["actor/loss"]) == 0.0 != float(second["actor/loss"])
    for part in ("actor", "critics"):
        before, after = getattr(one, part), getattr(two, part)
        expected = jax.tree.map(lambda s, n: 0.75 * np.asarray(s) + 0.25 * np.asarray(n), before.slow, after.now)
        tiny.assert_close(after.slow, expected, atol=1e-9)
    # Adam's first step has the size of its rate
    for before, after, rate in ((one.actor, two.actor, 1e-2), (state.critics, one.critics, 2e-2)):
        steps = jax.tree.map(lambda a, b: np.abs(np.asarray(a) - np.asarray(b)).max(), before.now, after.now)
        np.testing.assert_allclose(max(jax.tree.leaves(steps)), rate, rtol=1e-3)


def test_the_actors_rate_falls_with_its_own_steps_to_zero_and_stays_there():
    learner = dataclasses.replace(LEARNERS[0], actor_decay_updates=8)
    # its first step is the second update's, and half a cosine over four steps follows
    expected = [1e-2 * 0.5 * (1.0 + np.cos(np.pi * steps / 4.0)) for steps in (0, 1, 2, 3, 4, 4)]
    found = [learner.actor_rate(jnp.int32(update)) for update in (1, 3, 5, 7, 9, 101)]
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert LEARNERS[0].actor_rate(jnp.int32(101)) == 1e-2


@pytest.mark.parametrize("learner", LEARNERS, ids=[learner.kind for learner in LEARNERS])
def test_what_is_added_to_rewards_moves_the_target_by_as_much(learner):
    with tiny.exactly():
        state, batch = tiny.twin_delayed_state(learner), tiny.batch(extras=learner.view().extras)
        target = "targets" if isinstance(learner, SCAS) else "target"
        plain, shifted = (
            getattr(changed, target)(state, batch, jr.key(1))
            for changed in (learner, dataclasses.replace(learner, reward_shift=-1.0))
        )
        np.testing.assert_allclose(shifted, plain - 1.0, rtol=1e-9)
