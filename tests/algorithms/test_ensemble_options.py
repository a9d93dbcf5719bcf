"""Options of the ensemble's base: targets of its own for each member, priors, easing pessimism, scaled rewards."""

import dataclasses

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import networks, tiny
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.ensemble_state import Models
from odaf.algorithms.terms import OODPessimism
from odaf.algorithms.terms.ood_pessimism import Easing
from odaf.components.critics import CriticEnsemble, init_critics
from odaf.components.networks import MLP
from odaf.components.priors import init_priors
from odaf.errors import ConfigError


def _learner(**fields) -> EnsembleSAC:
    return EnsembleSAC(**{**tiny.SMALL, **fields})


@pytest.mark.parametrize("entropy", [False, True])
@pytest.mark.parametrize("deviations", [0.0, 0.7])
def test_each_member_may_have_a_target_of_its_own(entropy, deviations):
    with tiny.exactly():
        learner = _learner(
            target="member", target_deviations=deviations, entropy_in_backup=entropy, discount=0.9, value_range="none"
        )
        state, batch = tiny.state_of(learner), tiny.batch()
        with tiny.recorded() as drawn:
            y = np.asarray(learner.targets(state, batch, jr.fold_in(jr.key(5), 0)))  # as critic_gradient draws below
        actions, density = networks.act(state.actor.now, batch.next_observations, drawn[0])
        values = networks.q_values(state.target_critics, batch.next_observations, actions)
        for member in range(3):
            for row in range(tiny.ROWS):
                next_value = values[member, row] - deviations * np.std(values[:, row], ddof=1)
                next_value -= 0.5 * density[row] if entropy else 0.0
                expected = float(batch.rewards[row]) + 0.9 * (1.0 - float(batch.terminated[row])) * next_value
                assert y[member, row] == pytest.approx(expected, rel=1e-9)

        gradient, metrics = learner.critic_gradient(state, batch, jr.key(5))

        def loss(critics) -> float:
            found = networks.q_values(critics, batch.observations, batch.actions)
            return float(sum(np.mean((found[member] - y[member]) ** 2) for member in range(3)))

        np.testing.assert_allclose(metrics["critic/loss"], loss(state.online_critics), rtol=1e-9)
        tiny.assert_slopes(gradient, loss, state.online_critics)


def test_the_lowest_member_less_deviations_is_lower_by_just_them():
    with tiny.exactly():
        plain, lower = _learner(discount=0.9), _learner(discount=0.9, target_deviations=2.0)
        state, batch = tiny.state_of(plain), tiny.batch()
        with tiny.recorded() as drawn:
            y = np.asarray(plain.targets(state, batch, jr.key(5)))
        less = np.asarray(lower.targets(state, batch, jr.key(5)))
        actions, _ = networks.act(state.actor.now, batch.next_observations, drawn[0])
        values = networks.q_values(state.target_critics, batch.next_observations, actions)
    gap = 0.9 * (1.0 - np.asarray(batch.terminated)) * 2.0 * np.std(values, axis=0, ddof=1)
    np.testing.assert_allclose(y - less, gap, rtol=1e-6, atol=1e-9)


def _with_priors(scale: float = 0.5) -> CriticEnsemble:
    networks = init_critics(jr.key(1), 3, 2, (5, 4), 3, "none", 3e-3)
    return CriticEnsemble(networks, init_priors(jr.key(1), 3, 2, (5, 4), 3, scale))


def test_priors_are_added_to_every_member():
    with tiny.exactly():
        critics, batch = tiny.in_double(_with_priors()), tiny.batch()
        assert critics.priors is not None
        own = networks.q_values(dataclasses.replace(critics, priors=None), batch.observations, batch.actions)
        prior = networks.q_values(CriticEnsemble(critics.priors.networks), batch.observations, batch.actions)
        assert np.std(prior) > 10 * np.std(own), "fresh members are flat, fresh priors are not"
        for found in (
            critics(batch.observations, batch.actions),
            critics.as_constants(batch.observations, batch.actions),
        ):
            np.testing.assert_allclose(found, own + 0.5 * prior, rtol=1e-6)


def test_the_actor_sees_the_priors_slopes():
    with tiny.exactly():
        critics, batch = tiny.in_double(_with_priors()), tiny.batch()
        by_constants = jax.grad(lambda a: jnp.sum(critics.as_constants(batch.observations, a)))(batch.actions)
        plainly = jax.grad(lambda a: jnp.sum(critics(batch.observations, a)))(batch.actions)
    np.testing.assert_allclose(by_constants, plainly, rtol=1e-6)
    assert np.abs(by_constants).max() > 1e-2


def test_priors_never_move_and_both_copies_have_the_same():
    learner = _learner(prior_scale=1.0, terms=(OODPessimism(),), critic_norm="none")

    @jax.jit
    def train(key):
        first = learner.init(jr.fold_in(key, 0), tiny.SPEC, Models(((),)))
        keys = jr.split(jr.fold_in(key, 1), 5)
        return first, jax.lax.scan(lambda s, k: learner.update(s, tiny.batch(), k), first, keys)[0]

    first, last = train(jr.key(0))
    tiny.assert_same_bits(first.online_critics.priors, last.priors)
    tiny.assert_same_bits(first.target_critics.priors, last.target_critics.priors)
    assert not np.array_equal(first.online_critics.networks.weights[0], last.critics.now.weights[0])
    assert not np.array_equal(first.target_critics.networks.weights[0], last.target_critics.networks.weights[0])


def _eased(values, *, deviations: float = 1.0, decay_steps: int = 2000) -> list[float]:
    """lambda's factor after each update of PBRL's rule, from its description, in plain Python."""
    factor, records, epoch, factors = 1.0, [], [], []
    for step, value in enumerate(values, start=1):
        epoch.append(value)
        if step % 1000 == 0:
            records, epoch = [*records, sum(epoch) / 1000][-20:], []
            falls = len(records) == 20 and sum(records[15:]) / 5 < sum(records[:15]) / 15
            if step > decay_steps and falls and factor * deviations > 0.2:
                factor /= 1.01
        factors.append(factor)
    return factors


@pytest.mark.parametrize("slope", [-1.0, 1.0])
def test_pessimism_eases_where_the_policys_values_fall(slope):
    term = OODPessimism(adaptive=True, deviations=5.0, final_deviations=1.0, decay_steps=2000)
    rng = np.random.default_rng(0)
    values = (slope * np.arange(40_000) / 1000 + rng.normal(size=40_000)).astype(np.float32)

    @jax.jit
    def run(values):
        def step(memory, one):
            index, value = one
            memory = term.next_state(memory, index, {"ood/value": value})
            return memory, memory.factor

        return jax.lax.scan(step, term.init(()), (jnp.arange(1, len(values) + 1), values))[1]

    found, expected = np.asarray(run(values)), np.array(_eased(values))
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    assert (found[-1] < 1.0) == (slope < 0.0)


def test_easing_stops_at_its_least_and_reaches_the_loss():
    term = OODPessimism(adaptive=True, deviations=0.21, final_deviations=0.21)
    memory = term.init(())
    assert isinstance(memory, Easing)
    with tiny.exactly():
        learner = _learner(terms=(term,))
        state = tiny.state_of(learner, models=((),))
        eased = dataclasses.replace(memory, factor=tiny.floats(0.5))
        _, whole = learner.critic_additions(state.online_critics, state, tiny.batch(), jr.key(1))
        halved = dataclasses.replace(state, terms=(tiny.in_double(eased),))
        _, half = learner.critic_additions(state.online_critics, halved, tiny.batch(), jr.key(1))
    assert float(half["ood/deviations"]) == pytest.approx(0.5 * float(whole["ood/deviations"]))
    assert float(half["ood/loss"]) == pytest.approx(0.25 * float(whole["ood/loss"]), rel=1e-6)
    falling = _eased(-np.arange(100_000) / 1000, deviations=0.21, decay_steps=0)
    assert 0.2 / 1.01 <= falling[-1] * 0.21 <= 0.2


def test_scaled_rewards_scale_targets_and_bounds_and_leave_metrics_in_the_logs_units():
    with tiny.exactly():
        plain, scaled = _learner(discount=0.5), _learner(discount=0.5, reward_scale=0.25)
        state, batch = tiny.state_of(plain, bounds=(-2.0, 4.0)), tiny.batch()
        small = dataclasses.replace(
            state,
            reward_scale=tiny.floats(0.25),
            value_bounds=0.25 * state.value_bounds,
            critics=dataclasses.replace(
                state.critics, now=_times(state.critics.now, 0.25), slow=_times(state.target_critics.networks, 0.25)
            ),
        )
        y, small_y = plain.targets(state, batch, jr.key(5)), scaled.targets(small, batch, jr.key(5))
        np.testing.assert_allclose(0.25 * np.asarray(y), small_y, rtol=1e-9)
        _, metrics = plain.critic_gradient(state, batch, jr.key(5))
        _, small_metrics = scaled.critic_gradient(small, batch, jr.key(5))
    for name in ("critic/mean", "critic/min", "critic/max", "target/mean"):
        assert float(small_metrics[name]) == pytest.approx(float(metrics[name]), rel=1e-9)


def _times(networks: MLP, factor: float) -> MLP:
    """The same networks with every output multiplied."""
    return dataclasses.replace(
        networks,
        weights=(*networks.weights[:-1], factor * networks.weights[-1]),
        biases=(*networks.biases[:-1], factor * networks.biases[-1]),
    )


@pytest.mark.parametrize(
    ("low", "high", "scale"),
    [(-1.0, 2.0, 0.5), (0.05, 0.97, 1.0), (-1e6, 0.0, 2.0**-20), (0.0, 3e-7, 2.0**21), (0, 0, 1)],
)
def test_unit_brings_the_largest_logged_reward_near_one_by_a_power_of_two(low, high, scale):
    learner = _learner(reward_scale="unit", discount=0.9)
    spec = dataclasses.replace(tiny.SPEC, reward_min=low, reward_max=high, ever_terminates=False)
    assert float(learner._scale(spec)) == scale
    np.testing.assert_allclose(learner._value_bounds(spec), [10.0 * scale * low, 10.0 * scale * high], rtol=1e-6)


def test_auto_makes_the_largest_allowed_value_ten():
    learner = _learner(reward_scale="auto", discount=0.9)
    state = jax.jit(lambda key: learner.init(key, tiny.SPEC, Models()))(jr.key(0))
    # rewards in [-1, 2]: values in [-10, 20]
    assert float(state.reward_scale) == pytest.approx(0.5)
    np.testing.assert_allclose(state.value_bounds, [-5.0, 10.0], rtol=1e-6)
    nothing = dataclasses.replace(tiny.SPEC, reward_min=0.0, reward_max=0.0)
    assert float(jax.jit(lambda key: learner.init(key, nothing, Models()))(jr.key(0)).reward_scale) == 1.0


@pytest.mark.parametrize(
    "fields", [{"reward_scale": 0.0}, {"prior_scale": -1.0}, {"target_deviations": -0.1}, {"warm_start_steps": 0}]
)
def test_nonsense_is_refused(fields):
    with pytest.raises(ConfigError, match=next(iter(fields))):
        _learner(**fields)
