"""The ensemble soft actor-critic against its equations, and one update against its parts."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import networks, soft_actor_critic, tiny
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.terms import OODPessimism, OutcomePenalty
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.sampling import device_columns
from odaf.errors import ConfigError


def _learner(**fields) -> EnsembleSAC:
    return EnsembleSAC(**{**tiny.SMALL, **fields})


@pytest.mark.parametrize(("entropy", "norm", "steps"), [(False, "layer", 1), (True, "layer", 1), (True, "none", 3)])
def test_the_target_is_the_lowest_member_with_or_without_entropy(entropy, norm, steps):
    with tiny.exactly():
        learner = _learner(entropy_in_backup=entropy, critic_norm=norm, discount=0.9, return_steps=steps)
        state, batch = tiny.state_of(learner), tiny.batch()
        with tiny.recorded() as drawn:
            y = learner.targets(state, batch, jr.key(5))
        np.testing.assert_allclose(y, soft_actor_critic.target(state, batch, drawn[0], 0.9**steps, entropy), rtol=1e-9)


def test_the_target_is_cut_to_what_the_rewards_allow():
    with tiny.exactly():
        learner, bounds = _learner(discount=0.5), (-2.0, 1.0)
        state, batch = tiny.state_of(learner, bounds=bounds, size=2.0), tiny.batch(30)
        with tiny.recorded() as drawn:
            y = np.asarray(learner.targets(state, batch, jr.key(5)))
        free = soft_actor_critic.target(state, batch, drawn[0], 0.5, False)
        assert np.any(free < bounds[0]) and np.any(free > bounds[1]), "this state must test both sides"
        np.testing.assert_allclose(y, np.clip(free, *bounds), rtol=1e-9)


def test_true_ends_bootstrap_to_zero_and_time_outs_do_not():
    rng = np.random.default_rng(0)
    dataset = Dataset.from_arrays(
        rng.normal(size=(4, 3)),
        rng.uniform(-1, 1, (4, 2)),
        [0.5, 0.25, -0.5, 1.0],
        next_observations=rng.normal(size=(4, 3)),
        terminated=[False, True, False, False],
        truncated=[False, False, False, True],
        action_bounds=(-1, 1),
    )
    columns = device_columns(dataset, Normaliser.fit(dataset.observations))
    learner = _learner()
    with tiny.exactly():
        columns = tiny.in_double(columns)
        y = np.asarray(learner.targets(tiny.state_of(learner), columns, jr.key(0)))
    assert y[1] == 0.25
    assert np.all(np.abs(y[[0, 2, 3]] - dataset.rewards[[0, 2, 3]]) > 0.05), "the last row is a time-out"


def test_the_critics_descend_the_sum_of_their_squared_errors():
    with tiny.exactly():
        learner = _learner(discount=0.9)
        state, batch = tiny.state_of(learner), tiny.batch()
        with tiny.recorded() as drawn:
            gradient, metrics = learner.critic_gradient(state, batch, jr.key(5))
        assert len(drawn) == 1
        y = soft_actor_critic.target(state, batch, drawn[0], 0.9, False)
        values = networks.q_values(state.critics, batch.observations, batch.actions)
        expected = {
            "critic/loss": soft_actor_critic.critic_loss(state.critics, batch, y),
            "critic/mean": values.mean(),
            "critic/min": values.min(),
            "critic/max": values.max(),
            "target/mean": y.mean(),
        }
        assert set(metrics) == set(expected)
        for name, value in expected.items():
            np.testing.assert_allclose(metrics[name], value, rtol=1e-9)
        tiny.assert_slopes(gradient, lambda moved: soft_actor_critic.critic_loss(moved, batch, y), state.critics)


def test_the_terms_gradient_is_added_to_the_critics_own():
    term = OODPessimism(weight=0.7)
    with tiny.exactly():
        bare, with_term = _learner(), _learner(terms=(term,))
        state, batch = tiny.state_of(with_term, side=((),)), tiny.batch()
        own, _ = bare.critic_gradient(dataclasses.replace(state, side=(), memory=()), batch, jr.key(5))
        both, metrics = with_term.critic_gradient(state, batch, jr.key(5))

        def addition(critics):
            return with_term.critic_additions(critics, state, batch, jr.key(5))[0]

        value, slope = jax.value_and_grad(addition)(state.critics)
        tiny.assert_close(both, jax.tree.map(jnp.add, own, slope), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(value, 0.7 * float(metrics["ood/loss"]), rtol=1e-6)
    assert tiny.each_nonzero(slope.networks.weights)


@pytest.mark.parametrize("climbs", ["online", "target"])
def test_the_actor_climbs_the_lowest_member(climbs):
    with tiny.exactly():
        learner = _learner(actor_critic=climbs)
        state, batch = tiny.state_of(learner), tiny.batch()
        critics = state.critics if climbs == "online" else state.target_critics
        with tiny.recorded() as drawn:
            loss, (log_density, metrics) = learner.actor_loss(state.actor, state, batch, jr.key(5))

        def expected(actor) -> float:
            return soft_actor_critic.actor_loss(actor, critics, state.log_temperature, batch, drawn[0])

        actions, density = networks.act(state.actor, batch.observations, drawn[0])
        lowest = networks.q_values(critics, batch.observations, actions).min(axis=0)
        np.testing.assert_allclose(loss, expected(state.actor), rtol=1e-9)
        np.testing.assert_allclose(log_density, density, rtol=1e-9)
        np.testing.assert_allclose(metrics["actor/loss"], loss, rtol=1e-12)
        np.testing.assert_allclose(metrics["actor/entropy"], -density.mean(), rtol=1e-9)
        np.testing.assert_allclose(metrics["actor/value"], lowest.mean(), rtol=1e-9)
        gradient = jax.grad(lambda actor: learner.actor_loss(actor, state, batch, jr.key(5))[0])(state.actor)
        tiny.assert_slopes(gradient, expected, state.actor)


def test_only_the_actor_feels_the_actors_loss():
    learner = _learner(terms=(OutcomePenalty(dynamics=tiny.dynamics_config()), OODPessimism()))

    def loss(actor, state):
        return learner.actor_loss(actor, state, tiny.batch(), jr.key(5))[0]

    with tiny.exactly():
        state = tiny.state_of(learner, side=(tiny.dynamics_model(tiny.dynamics_config()), ()))
        by_actor = jax.grad(loss)(state.actor, state)
        by_state = eqx.filter_grad(lambda state, actor: loss(actor, state))(state, state.actor)
    assert tiny.each_nonzero(by_actor) and tiny.all_zero(by_state)


def _first_adam_step(parameters, gradient, rate: float):
    """Adam's bias-corrected moments are the gradient and its square at the first step."""

    def moved(parameter, slope):
        slope = np.asarray(slope, np.float64)
        return np.asarray(parameter, np.float64) - rate * slope / (np.abs(slope) + 1e-8)

    return jax.tree.map(moved, parameters, gradient)


RATES = {
    "actor_learning_rate": 1e-2,
    "critic_learning_rate": 2e-2,
    "temperature_learning_rate": 3e-2,
    "target_rate": 0.25,
    "slow_actor_rate": 0.125,
}


def test_one_update_takes_every_step_from_the_old_parameters_and_then_moves_the_slow_copies():
    learner = _learner(**RATES)
    with tiny.exactly():
        old, batch = tiny.state_of(learner), tiny.batch()
        new, metrics = learner.update(old, batch, jr.key(7))
        key_actor, key_critic = jr.split(jr.key(7))
        actor_gradient, (log_density, _) = jax.grad(learner.actor_loss, has_aux=True)(old.actor, old, batch, key_actor)
        critic_gradient, _ = learner.critic_gradient(old, batch, key_critic)
    actor = _first_adam_step(old.actor, actor_gradient, 1e-2)
    critics = _first_adam_step(old.critics, critic_gradient, 2e-2)
    slow_actor = jax.tree.map(lambda s, o: 0.875 * np.asarray(s) + 0.125 * o, old.slow_actor, actor)
    target_critics = jax.tree.map(lambda s, o: 0.75 * np.asarray(s) + 0.25 * o, old.target_critics, critics)
    tiny.assert_close(new.actor, actor, atol=1e-9)
    tiny.assert_close(new.critics, critics, atol=1e-9)
    tiny.assert_close(new.slow_actor, slow_actor, atol=1e-9)
    tiny.assert_close(new.target_critics, target_critics, atol=1e-9)
    slope = -np.mean(np.asarray(log_density) - 2.0)  # the target entropy is minus the number of actions
    assert float(new.log_temperature) == pytest.approx(np.log(0.5) - 3e-2 * np.sign(slope), abs=1e-5)
    assert float(metrics["temperature/value"]) == pytest.approx(np.exp(float(new.log_temperature)), rel=1e-5)
    assert int(new.step) == 1
    tiny.assert_same_bits(new.value_bounds, old.value_bounds)


@pytest.mark.parametrize(("target_entropy", "rises"), [(50.0, True), (-50.0, False)])
def test_the_temperature_rises_while_entropy_is_below_its_target(target_entropy, rises):
    learner = _learner(target_entropy=target_entropy)
    with tiny.exactly():
        old = tiny.state_of(learner)
        new, _ = learner.update(old, tiny.batch(), jr.key(7))
    assert (float(new.log_temperature) > float(old.log_temperature)) is rises


def test_a_temperature_rate_of_zero_holds_the_temperature():
    learner = _learner(temperature_learning_rate=0.0)
    with tiny.exactly():
        old = tiny.state_of(learner)
        new, _ = learner.update(old, tiny.batch(), jr.key(7))
    tiny.assert_same_bits(new.log_temperature, old.log_temperature)


def test_the_start_has_equal_slow_copies_and_the_configured_numbers():
    learner = _learner(discount=0.9, initial_temperature=0.3, critic_output_bound=0.2)
    state = jax.jit(lambda key: learner.init(key, tiny.SPEC, ()))(jr.key(0))
    tiny.assert_same_bits(state.actor, state.slow_actor)
    tiny.assert_same_bits(state.critics, state.target_critics)
    np.testing.assert_allclose(state.value_bounds, [-10.0, 20.0], rtol=1e-6)
    assert int(state.step) == 0 and float(state.log_temperature) == pytest.approx(np.log(0.3))
    assert 0.1 < np.abs(state.critics.networks.weights[-1]).max() <= 0.2
    free = jax.jit(lambda key: _learner(value_range="none").init(key, tiny.SPEC, ()))(jr.key(0))
    np.testing.assert_array_equal(free.value_bounds, [-np.inf, np.inf])


@pytest.mark.parametrize("deployed", ["current", "slow"])
def test_the_policy_is_the_squashed_mean_of_the_deployed_actor(deployed):
    learner = _learner(deployed_actor=deployed)
    state, states = tiny.state_of(learner), tiny.batch().observations
    actor = state.actor if deployed == "current" else state.slow_actor
    np.testing.assert_allclose(learner.actor(state).mode(states), networks.mode(actor, states), rtol=1e-4, atol=1e-6)


def test_one_key_gives_one_course_of_training_bit_for_bit():
    learner = _learner(terms=(OutcomePenalty(dynamics=tiny.dynamics_config()), OODPessimism()))

    def train(key):
        side = learner.untrained_side(jr.fold_in(key, 10), tiny.SPEC)
        state = learner.init(jr.fold_in(key, 11), tiny.SPEC, side)
        return jax.lax.scan(
            lambda state, step: learner.update(state, tiny.batch(), jr.fold_in(key, step)), state, jnp.arange(3)
        )

    run = jax.jit(train)
    (first, metrics), again, (other, _) = run(jr.key(1)), run(jr.key(1)), run(jr.key(2))
    tiny.assert_same_bits((first, metrics), again)
    assert not np.array_equal(first.actor.network.weights[0], other.actor.network.weights[0])
    assert all(np.all(np.isfinite(series)) and len(series) == 3 for series in metrics.values())


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"discount": 1.0}, r"discount=1.0 must lie in \[0, 1\)"),
        ({"num_critics": 1}, "num_critics=1.*at least 2"),
        ({"initial_temperature": 0.0}, "initial_temperature=0.0 must be positive"),
        ({"terms": (OODPessimism(), OODPessimism(weight=0.0))}, "contain one term twice"),
        ({"target_rate": 0.0}, "target_rate=0.0"),
        ({"slow_actor_rate": 1.5}, "slow_actor_rate=1.5"),
        ({"batch_size": 0}, "batch_size=0"),
        ({"return_steps": 0}, "return_steps=0"),
        ({"hidden_sizes": (32, 0)}, "hidden_sizes"),
    ],
)
def test_settings_that_cannot_work_are_refused(fields, message):
    with pytest.raises(ConfigError, match=message):
        dataclasses.replace(EnsembleSAC(), **fields)
