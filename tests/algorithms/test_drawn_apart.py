"""Critics and an actor that learn from rows of their own: each from its own, and from no others."""

import dataclasses

import jax
import jax.numpy as jnp
import jax.random as jr
import pytest

from golden import tiny
from odaf.algorithms.cql import CQL
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.iql import IQL
from odaf.algorithms.rebrac import ReBRAC
from odaf.algorithms.td3_bc import TD3BC
from odaf.algorithms.truncated_quantile_critics import TruncatedQuantileCritics

SMALL = {"hidden_sizes": (4,), "batch_size": tiny.ROWS}
# Where the critics step before the actor, the actor hears of their rows through them; these settings close its ears.
LEARNERS = [
    EnsembleSAC(**SMALL, num_critics=2),
    CQL(actor_hidden_sizes=(4,), critic_hidden_sizes=(4,), batch_size=tiny.ROWS, num_actions=2),
    TruncatedQuantileCritics(**SMALL, num_quantiles=4, dropped=1),
    TD3BC(**SMALL, value_weight=0.0, actor_delay=1),
    ReBRAC(**SMALL, critic_learning_rate=0.0, actor_delay=1),
    IQL(**SMALL, inverse_temperature=0.0, reward_scale=1.0, actor_decay_updates=0),
]


def _same(first, second) -> bool:
    pairs = zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True)
    return all(bool(jnp.array_equal(ours, theirs)) for ours, theirs in pairs)


@pytest.mark.parametrize("learner", LEARNERS, ids=lambda learner: learner.kind)
def test_each_learns_from_its_own_rows_alone(learner):
    key = jr.key(1)
    state = jax.jit(lambda key: learner.init(key, tiny.SPEC, learner.untrained(key, tiny.SPEC)))(key)
    update = jax.jit(learner.update)
    extras = learner.view().extras
    logged, other, third = (tiny.batch(seed=seed, extras=extras) for seed in range(3))

    def after(critics, actor):
        return update(state, dataclasses.replace(critics, actor=actor), jr.key(2))[0]

    both, other_critics, other_actor = after(logged, other), after(third, other), after(logged, third)
    assert _same(learner.actor(both), learner.actor(other_critics))
    assert not _same(learner.actor(both), learner.actor(other_actor))
    assert _same(both.critics, other_actor.critics)
    assert not _same(both.critics, other_critics.critics)
    assert learner.draws_apart
