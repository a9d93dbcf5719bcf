"""Behaviour cloning against its formula."""

import dataclasses

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import networks, tiny
from odaf.algorithms.behaviour_cloning import BehaviourCloning, cloning_loss
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError


def _initial(learner: BehaviourCloning):
    return jax.jit(lambda key: learner.init(key, tiny.SPEC, ()))(jr.key(0))


def test_the_loss_is_the_mean_over_rows_and_action_dimensions():
    with tiny.exactly():
        learner, batch = BehaviourCloning(hidden_sizes=(5, 4)), tiny.batch()
        actor = tiny.filled(jax.eval_shape(lambda: learner.init(jr.key(0), tiny.SPEC, ()).actor.now))

        def expected(actor) -> float:
            actions = np.tanh(networks.mlp(actor.network, batch.observations))
            return float(np.mean((actions - networks.numbers(batch.actions)) ** 2))

        loss, gradient = jax.value_and_grad(cloning_loss)(actor, batch)
        np.testing.assert_allclose(loss, expected(actor), rtol=1e-10)
        tiny.assert_slopes(gradient, expected, actor)


def test_the_gaussian_maximises_the_likelihood_and_acts_by_its_mean():
    with tiny.exactly():
        learner, batch = BehaviourCloning(hidden_sizes=(5, 4), actor_kind="gaussian"), tiny.batch()
        actor = tiny.filled(jax.eval_shape(lambda: learner.init(jr.key(0), tiny.SPEC, ()).actor.now))

        def expected(actor) -> float:
            mean, log_std = np.tanh(networks.mlp(actor.network, batch.observations)), networks.numbers(actor.log_std)
            off = (networks.numbers(batch.actions) - mean) / np.exp(log_std)
            return float(np.mean(np.sum(0.5 * off**2 + log_std + 0.5 * np.log(2.0 * np.pi), axis=-1)))

        loss, gradient = jax.value_and_grad(cloning_loss)(actor, batch)
        np.testing.assert_allclose(loss, expected(actor), rtol=1e-10)
        tiny.assert_slopes(gradient, expected, actor)
        acts = np.tanh(networks.mlp(actor.network, batch.observations))
        np.testing.assert_allclose(actor.mode(batch.observations), acts, rtol=1e-10)


def test_the_spread_of_the_gaussian_is_that_of_what_cannot_be_cloned():
    """Actions with noise of 0.5 and 0.1 around 0 that the states do not say."""
    learner = BehaviourCloning(hidden_sizes=(4,), learning_rate=2e-2, batch_size=512, actor_kind="gaussian")
    noise = np.random.default_rng(0).normal(size=(512, 2)) * [0.5, 0.1]
    batch = tiny.batch(512)
    batch = dataclasses.replace(
        batch, observations=jnp.zeros_like(batch.observations), actions=jnp.asarray(noise, jnp.float32)
    )

    @jax.jit
    def train(state):
        return jax.lax.scan(lambda s, _: (learner.update(s, batch, jr.key(0))[0], None), state, length=600)[0]

    actor = train(_initial(learner)).actor.now
    np.testing.assert_allclose(jnp.exp(actor.log_std), noise.std(axis=0), rtol=0.03)
    np.testing.assert_allclose(actor.mode(batch.observations)[0], noise.mean(axis=0), atol=0.02)


def test_training_finds_a_policy_that_can_be_cloned():
    learner = BehaviourCloning(hidden_sizes=(32,), learning_rate=1e-2, batch_size=64)
    rng = np.random.default_rng(0)
    batch = tiny.batch(64)
    wanted = np.tanh(np.asarray(batch.observations) @ rng.normal(size=(3, 2)).astype(np.float32))
    batch = batch.__class__(
        batch.observations, jnp.asarray(wanted), batch.rewards, batch.next_observations, batch.terminated
    )

    @jax.jit
    def train(state):
        return jax.lax.scan(lambda s, _: (learner.update(s, batch, jr.key(0))[0], None), state, length=500)[0]

    state = train(_initial(learner))
    assert int(state.step) == 500
    assert float(cloning_loss(state.actor.now, batch)) < 1e-3  # 0.4 before training
    np.testing.assert_allclose(learner.actor(state).mode(batch.observations), wanted, atol=0.15)


def test_one_key_gives_one_course_of_training_bit_for_bit():
    learner = BehaviourCloning(hidden_sizes=(5,))

    @jax.jit
    def train(key):
        state = learner.init(key, tiny.SPEC, ())
        return jax.lax.scan(lambda s, k: learner.update(s, tiny.batch(), k), state, jr.split(jr.key(5), 4))

    (first, metrics), (again, _), (other, _) = (train(jr.key(key)) for key in (0, 0, 1))
    assert set(metrics) == {"actor/loss"} and np.all(np.diff(metrics["actor/loss"]) < 0.0)
    tiny.assert_same_bits(first, again)
    assert not np.array_equal(first.actor.now.network.weights[0], other.actor.now.network.weights[0])


def test_there_is_nothing_to_pretrain():
    dataset = tiny.linear_dataset(episodes=2, length=3)
    side, report = BehaviourCloning().pretrain(
        dataset, Normaliser.fit(dataset.observations), jr.key(0), lambda *_: None
    )
    assert side == () and report == {"warnings": []}


def test_what_is_added_to_spreads_reaches_the_normaliser():
    assert BehaviourCloning(normaliser_epsilon=1e-3).view().normaliser_epsilon == 1e-3
    assert BehaviourCloning().view().normaliser_epsilon == 0.0
    with pytest.raises(ConfigError, match="normaliser_epsilon=-1.0 must not be negative"):
        BehaviourCloning(normaliser_epsilon=-1.0)
