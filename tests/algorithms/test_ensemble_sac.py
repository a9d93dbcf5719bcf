"""The ensemble soft actor-critic against its equations, and one update against its parts."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import networks, soft_actor_critic, tiny
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.ensemble_state import Models
from odaf.algorithms.terms import OODPessimism, OutcomePenalty, Term
from odaf.components.critics import CriticEnsemble
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
        values = networks.q_values(state.online_critics, batch.observations, batch.actions)
        expected = {
            "critic/loss": soft_actor_critic.critic_loss(state.online_critics, batch, y),
            "critic/mean": values.mean(),
            "critic/min": values.min(),
            "critic/max": values.max(),
            "target/mean": y.mean(),
        }
        assert set(metrics) == set(expected)
        for name, value in expected.items():
            np.testing.assert_allclose(metrics[name], value, rtol=1e-9)
        tiny.assert_slopes(
            gradient,
            lambda moved: soft_actor_critic.critic_loss(CriticEnsemble(moved), batch, y),
            state.critics.now,
        )


def test_the_terms_gradient_is_added_to_the_critics_own():
    term = OODPessimism(weight=0.7)
    with tiny.exactly():
        bare, with_term = _learner(), _learner(terms=(term,))
        state, batch = tiny.state_of(with_term, models=((),)), tiny.batch()
        own, _ = bare.critic_gradient(dataclasses.replace(state, terms=()), batch, jr.key(5))
        both, metrics = with_term.critic_gradient(state, batch, jr.key(5))

        def addition(critics):
            return with_term.critic_additions(critics, state, batch, jr.key(5))[0]

        value, slope = jax.value_and_grad(addition)(state.online_critics)
        tiny.assert_close(both, jax.tree.map(jnp.add, own, slope.networks), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(value, 0.7 * float(metrics["ood/loss"]), rtol=1e-6)
    assert tiny.each_nonzero(slope.networks.weights)


@dataclasses.dataclass(frozen=True)
class CautiousTarget(Term):
    """Takes weight * |a'| off the value of every next state."""

    name: ClassVar[str] = "cautious"
    acts_on_target: ClassVar[bool] = True
    weight: float = 2.0

    def target_penalty(self, context, state, next_actions, log_density, key):
        return self.weight * jnp.sum(jnp.abs(next_actions), axis=1)


@pytest.mark.parametrize("target", ["min", "member"])
def test_a_term_can_lower_the_target(target):
    with tiny.exactly():
        bare = _learner(discount=0.9, target=target)
        with_term = dataclasses.replace(bare, terms=(CautiousTarget(),))
        state, batch = tiny.state_of(bare), tiny.batch()
        with tiny.recorded() as drawn:
            y = np.asarray(bare.targets(state, batch, jr.key(5)))
        lower = np.asarray(with_term.targets(dataclasses.replace(state, terms=((),)), batch, jr.key(5)))
        actions, _ = networks.act(state.actor.now, batch.next_observations, drawn[0])
    penalty = 0.9 * (1.0 - np.asarray(batch.terminated)) * 2.0 * np.abs(actions).sum(axis=1)
    np.testing.assert_allclose(y - lower, np.broadcast_to(penalty, y.shape), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("climbs", ["online", "target"])
def test_the_actor_climbs_the_lowest_member(climbs):
    with tiny.exactly():
        learner = _learner(actor_critic=climbs)
        state, batch = tiny.state_of(learner), tiny.batch()
        critics = state.online_critics if climbs == "online" else state.target_critics
        with tiny.recorded() as drawn:
            loss, (log_density, metrics) = learner.actor_loss(state.actor.now, state, batch, jr.key(5))

        def expected(actor) -> float:
            return soft_actor_critic.actor_loss(actor, critics, state.log_temperature.now, batch, drawn[0])

        actions, density = networks.act(state.actor.now, batch.observations, drawn[0])
        lowest = networks.q_values(critics, batch.observations, actions).min(axis=0)
        np.testing.assert_allclose(loss, expected(state.actor.now), rtol=1e-9)
        np.testing.assert_allclose(log_density, density, rtol=1e-9)
        np.testing.assert_allclose(metrics["actor/loss"], loss, rtol=1e-12)
        np.testing.assert_allclose(metrics["actor/entropy"], -density.mean(), rtol=1e-9)
        np.testing.assert_allclose(metrics["actor/value"], lowest.mean(), rtol=1e-9)
        gradient = jax.grad(lambda actor: learner.actor_loss(actor, state, batch, jr.key(5))[0])(state.actor.now)
        tiny.assert_slopes(gradient, expected, state.actor.now)


def test_only_the_actor_feels_the_actors_loss():
    learner = _learner(terms=(OutcomePenalty(dynamics=tiny.dynamics_config()), OODPessimism()))

    def loss(actor, state):
        return learner.actor_loss(actor, state, tiny.batch(), jr.key(5))[0]

    with tiny.exactly():
        state = tiny.state_of(learner, models=(tiny.dynamics_model(tiny.dynamics_config()), ()))
        by_actor = jax.grad(loss)(state.actor.now, state)
        by_state = eqx.filter_grad(lambda state, actor: loss(actor, state))(state, state.actor.now)
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
        actor_gradient, (log_density, _) = jax.grad(learner.actor_loss, has_aux=True)(
            old.actor.now, old, batch, key_actor
        )
        critic_gradient, _ = learner.critic_gradient(old, batch, key_critic)
    actor = _first_adam_step(old.actor.now, actor_gradient, 1e-2)
    critics = _first_adam_step(old.critics.now, critic_gradient, 2e-2)
    slow_actor = jax.tree.map(lambda s, o: 0.875 * np.asarray(s) + 0.125 * o, old.slow_actor, actor)
    target_critics = jax.tree.map(lambda s, o: 0.75 * np.asarray(s) + 0.25 * o, old.critics.slow, critics)
    tiny.assert_close(new.actor.now, actor, atol=1e-9)
    tiny.assert_close(new.critics.now, critics, atol=1e-9)
    tiny.assert_close(new.slow_actor, slow_actor, atol=1e-9)
    tiny.assert_close(new.critics.slow, target_critics, atol=1e-9)
    slope = -np.mean(np.asarray(log_density) - 2.0)  # the target entropy is minus the number of actions
    assert float(new.log_temperature.now) == pytest.approx(np.log(0.5) - 3e-2 * np.sign(slope), abs=1e-5)
    assert float(metrics["temperature/value"]) == pytest.approx(np.exp(float(new.log_temperature.now)), rel=1e-5)
    assert int(new.step) == 1
    tiny.assert_same_bits(new.value_bounds, old.value_bounds)


@pytest.mark.parametrize(("target_entropy", "rises"), [(50.0, True), (-50.0, False)])
def test_the_temperature_rises_while_entropy_is_below_its_target(target_entropy, rises):
    learner = _learner(target_entropy=target_entropy)
    with tiny.exactly():
        old = tiny.state_of(learner)
        new, _ = learner.update(old, tiny.batch(), jr.key(7))
    assert (float(new.log_temperature.now) > float(old.log_temperature.now)) is rises


def test_a_temperature_rate_of_zero_holds_the_temperature():
    learner = _learner(temperature_learning_rate=0.0)
    with tiny.exactly():
        old = tiny.state_of(learner)
        new, _ = learner.update(old, tiny.batch(), jr.key(7))
    tiny.assert_same_bits(new.log_temperature.now, old.log_temperature.now)


def test_the_start_has_equal_slow_copies_and_the_configured_numbers():
    learner = _learner(discount=0.9, initial_temperature=0.3, critic_output_bound=0.2)
    state = jax.jit(lambda key: learner.init(key, tiny.SPEC, Models()))(jr.key(0))
    tiny.assert_same_bits(state.actor.now, state.slow_actor)
    tiny.assert_same_bits(state.online_critics, state.target_critics)
    np.testing.assert_allclose(state.value_bounds, [-10.0, 20.0], rtol=1e-6)
    assert int(state.step) == 0 and float(state.log_temperature.now) == pytest.approx(np.log(0.3))
    assert 0.1 < np.abs(state.online_critics.networks.weights[-1]).max() <= 0.2
    free = jax.jit(lambda key: _learner(value_range="none").init(key, tiny.SPEC, Models()))(jr.key(0))
    np.testing.assert_array_equal(free.value_bounds, [-np.inf, np.inf])


@pytest.mark.parametrize("deployed", ["current", "slow"])
def test_the_policy_is_the_squashed_mean_of_the_deployed_actor(deployed):
    learner = _learner(deployed_actor=deployed)
    state, states = tiny.state_of(learner), tiny.batch().observations
    actor = state.actor.now if deployed == "current" else state.slow_actor
    np.testing.assert_allclose(learner.actor(state).mode(states), networks.mode(actor, states), rtol=1e-4, atol=1e-6)


def test_one_key_gives_one_course_of_training_bit_for_bit():
    learner = _learner(terms=(OutcomePenalty(dynamics=tiny.dynamics_config()), OODPessimism()))

    def train(key):
        models = learner.untrained(jr.fold_in(key, 10), tiny.SPEC)
        state = learner.init(jr.fold_in(key, 11), tiny.SPEC, models)
        return jax.lax.scan(
            lambda state, step: learner.update(state, tiny.batch(), jr.fold_in(key, step)), state, jnp.arange(3)
        )

    run = jax.jit(train)
    (first, metrics), again, (other, _) = run(jr.key(1)), run(jr.key(1)), run(jr.key(2))
    tiny.assert_same_bits((first, metrics), again)
    assert not np.array_equal(first.actor.now.network.weights[0], other.actor.now.network.weights[0])
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
