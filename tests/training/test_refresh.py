"""A learner that rolls a model out into a buffer: when that happens is a matter of the update's number alone."""

import dataclasses
import itertools
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from jaxtyping import Array, Float, Int

from golden import tiny
from odaf.algorithms.base import Algorithm, LearnerState
from odaf.components.policies import DeterministicActor, init_deterministic_actor
from odaf.data.normalisation import Normaliser
from odaf.data.sampling import sample, training_columns
from odaf.data.transitions import Transitions
from odaf.training import loop

BUFFER = 12


class RollingState(LearnerState):
    step: Int[Array, ""]
    actor: DeterministicActor
    model: Float[Array, "inputs obs_dim"]
    buffer: Float[Array, "buffer obs_dim"]  # imagined successors
    refreshes: Int[Array, ""]


@dataclasses.dataclass(frozen=True)
class RollingLearner(Algorithm[RollingState]):
    """Clones actions at states that a linear model, itself in training, imagined every `refresh_every` updates."""

    kind: ClassVar[str] = "rolling"
    refresh_every: int = 4
    batch_size: int = 6
    learning_rate: float = 0.05

    def init(self, key, spec, models):
        actor = init_deterministic_actor(key, spec.obs_dim, spec.act_dim, (4,))
        model = 0.1 * jr.normal(jr.fold_in(key, 1), (spec.obs_dim + spec.act_dim, spec.obs_dim))
        return RollingState(jnp.asarray(0), actor, model, jnp.zeros((BUFFER, spec.obs_dim)), jnp.asarray(0))

    def refresh(self, state: Any, columns, key):
        key_rows, key_noise = jr.split(key)
        start = sample(columns, key_rows, BUFFER).observations
        imagined = jnp.concatenate([start, state.actor.mode(start)], axis=1) @ state.model
        imagined = imagined + 0.1 * jr.normal(key_noise, imagined.shape)
        return dataclasses.replace(state, buffer=imagined, refreshes=state.refreshes + 1)

    def batch(self, state: Any, columns, key):
        real = sample(columns, key, self.batch_size)
        rows = jr.randint(jr.fold_in(key, 1), (self.batch_size,), 0, BUFFER)
        return dataclasses.replace(real, next_observations=state.buffer[rows])

    def update(self, state: Any, batch: Transitions, key):
        def loss(actor):
            return jnp.mean(jnp.square(actor.mode(batch.next_observations) - batch.actions))

        value, gradient = jax.value_and_grad(loss)(state.actor)
        actor = jax.tree.map(lambda p, g: p - self.learning_rate * g, state.actor, gradient)
        inputs = jnp.concatenate([batch.observations, batch.actions], axis=1)
        model = state.model - self.learning_rate * inputs.T @ (inputs @ state.model - batch.observations)
        return dataclasses.replace(state, step=state.step + 1, actor=actor, model=model), {"actor/loss": value}

    def actor(self, state: Any):
        return state.actor


def _run(learner, cuts):
    dataset = tiny.linear_dataset(episodes=3, length=10)
    columns = training_columns(dataset, Normaliser.fit(dataset.observations), learner.view())
    state = loop.donatable(loop.first_state(learner, dataset.spec(), loop.init_key(0), ()))
    for first, last in itertools.pairwise(cuts):
        state, _ = loop.train_stretch(
            learner, columns, loop.training_key(0), loop.update_number(first), loop.update_number(last), state
        )
    return state


@pytest.mark.parametrize("cuts", [(0, 4, 11), (0, 3, 5, 8, 11), tuple(range(12))])
def test_where_a_run_is_cut_changes_no_bit(cuts):
    tiny.assert_same_bits(_run(RollingLearner(), cuts), _run(RollingLearner(), (0, 11)))


def test_it_happens_before_every_nth_update_the_first_included():
    assert [int(_run(RollingLearner(), (0, last)).refreshes) for last in (1, 4, 5, 9)] == [1, 1, 2, 3]
    assert np.any(np.asarray(_run(RollingLearner(), (0, 1)).buffer) != 0.0)


def test_a_learner_that_never_refreshes_compiles_nothing_of_it(monkeypatch):
    def fail(*_):
        raise AssertionError("refresh was traced")

    monkeypatch.setattr(RollingLearner, "refresh", fail)
    assert int(_run(RollingLearner(refresh_every=0), (0, 3)).step) == 3
