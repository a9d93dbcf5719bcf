"""Actors: bounds, draws, densities; the contract holds an actor with a memory, and one that ranks candidates."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from jaxtyping import Array, Float
from scipy import integrate, stats

from golden import tiny
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.truncated_quantile_critics import TruncatedQuantileCritics
from odaf.components.critics import CriticEnsemble
from odaf.components.networks import MLP
from odaf.components.policies import Actor, DeterministicActor, GaussianActor, init_deterministic_actor
from odaf.errors import OdafError


def _gaussian(mean: float, log_std: float) -> GaussianActor:
    """One observation, one action, and the same distribution everywhere."""
    weights, biases = (tiny.floats(np.zeros((1, 2))),), (tiny.floats([mean, log_std]),)
    return GaussianActor(MLP(weights, biases, (), (), "relu"))


def _rows(count: int, width: int = tiny.OBS_DIM) -> jax.Array:
    return tiny.floats(np.random.default_rng(0).normal(size=(count, width)))


@pytest.mark.parametrize(("mean", "log_std"), [(0.0, -0.5), (0.7, -1.5), (-1.0, 0.5), (3.0, 1.0), (0.0, 2.0)])
def test_log_density_integrates_to_one_however_wide(mean, log_std):
    with tiny.exactly():
        pre_tanh = np.linspace(-17.0, 17.0, 20_001)
        actions = np.tanh(pre_tanh)
        found = np.asarray(
            _gaussian(mean, log_std).log_density(
                tiny.floats(np.zeros((len(actions), 1))), tiny.floats(actions)[:, None]
            )
        )
        # da = (1 - tanh(u)^2) du, with a width that keeps its digits where the spacing of actions loses them.
        mass = np.exp(found) / np.cosh(pre_tanh) ** 2
        beyond = 2.0 - stats.norm.cdf((17.0 - mean) / np.exp(log_std)) - stats.norm.cdf((17.0 + mean) / np.exp(log_std))
        assert abs(integrate.simpson(mass, x=pre_tanh) + beyond - 1.0) < 1e-4


def test_log_density_keeps_its_digits_near_a_bound_and_is_finite_on_it():
    actor, inside = _gaussian(0.5, 0.3), np.float32(1.0 - 2.0**-24)
    actions = np.array([inside, 1.0, -inside, -1.0, 0.999, 0.0], np.float32)
    found = np.asarray(actor.log_density(jnp.zeros((len(actions), 1)), jnp.asarray(actions)[:, None]))
    exact = np.clip(actions, -inside, inside).astype(np.float64)
    wanted = stats.norm.logpdf(np.arctanh(exact), 0.5, np.exp(0.3)) - np.log1p(-np.square(exact))
    np.testing.assert_allclose(found, wanted, rtol=2e-6, atol=2e-5)


def test_draws_are_in_bounds_differ_by_key_and_have_the_density_that_is_claimed():
    actor, rows = tiny.filled(tiny.state_of(EnsembleSAC(**tiny.SMALL)).actor.now, 5, 3.0), _rows(2000)
    first, carry = actor.act((), rows, jr.key(0))
    again, _ = actor.act((), rows, jr.key(0))
    other, _ = actor.act((), rows, jr.key(1))
    assert carry == () and bool((jnp.abs(first) <= 1.0).all())
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert bool(jnp.isfinite(actor.log_density(rows, first)).all())  # also of draws that tanh has rounded onto a bound
    level = _gaussian(0.3, -0.4)
    actions, _ = level.act((), jnp.zeros((4000, 1)), jr.key(2))
    ranks = stats.norm.cdf((np.arctanh(np.asarray(actions, np.float64)[:, 0]) - 0.3) / np.exp(-0.4))
    assert stats.kstest(ranks, "uniform").pvalue > 1e-3


def test_a_deterministic_actor_ignores_the_key_and_says_that_it_has_no_density():
    actor = init_deterministic_actor(jr.key(0), tiny.OBS_DIM, tiny.ACT_DIM, (4,))
    rows = _rows(3)
    np.testing.assert_array_equal(actor.act((), rows)[0], actor.act((), rows, jr.key(1))[0])
    np.testing.assert_array_equal(actor.mode(rows), actor.act((), rows)[0])
    with pytest.raises(OdafError, match="DeterministicActor: has no density"):
        actor.log_density(rows, actor.mode(rows))


def test_every_learner_gives_its_actor_and_its_critics_or_none():
    state = tiny.state_of(EnsembleSAC(**tiny.SMALL))
    assert EnsembleSAC(**tiny.SMALL).actor(state) is state.actor.now
    assert EnsembleSAC(**tiny.SMALL, deployed_actor="slow").actor(state) is state.slow_actor
    assert EnsembleSAC(**tiny.SMALL).values(state) == state.online_critics
    quantiles = TruncatedQuantileCritics(hidden_sizes=(4,), num_quantiles=5, num_critics=3)
    state = quantiles.init(jr.key(0), tiny.SPEC)
    assert quantiles.actor(state) is state.actor.now
    rows, actions = _rows(4), jnp.zeros((4, tiny.ACT_DIM))
    assert quantiles.values(state)(rows, actions).shape == (3, 4)
    cloning = BehaviourCloning(hidden_sizes=(4,))
    state = cloning.init(jr.key(0), tiny.SPEC, ())
    assert isinstance(cloning.actor(state), DeterministicActor) and cloning.values(state) is None


class ReturnToGo(Actor):
    """Asks for what is left of a wanted return; its action is that number, squashed."""

    wanted: Float[Array, ""]

    def begin(self, rows):
        return jnp.full((rows,), self.wanted)

    def act(self, carry, observations, key=None):
        return jnp.tanh(carry[:, None] + 0.0 * observations[:, :1]), carry

    def observe(self, carry, rewards):
        return carry - rewards


class BestCandidate(Actor):
    """Ranks fixed draws of a Gaussian actor by the lowest critic; with a key, fresh draws."""

    proposals: GaussianActor
    critics: CriticEnsemble
    draws: Float[Array, "draws act_dim"]

    def act(self, carry, observations, key=None):
        rows, draws = observations.shape[0], self.draws.shape[0]
        noise = jnp.broadcast_to(self.draws[:, None, :], (draws, rows, self.draws.shape[1]))
        if key is not None:
            noise = jr.normal(key, noise.shape)
        seen = jnp.broadcast_to(observations[None], (draws, *observations.shape)).reshape(draws * rows, -1)
        actions, _ = self.proposals.sample(seen, noise.reshape(draws * rows, -1))
        values = jnp.min(self.critics(seen, actions), axis=0).reshape(draws, rows)
        best = jnp.argmax(values, axis=0)
        return jnp.take_along_axis(actions.reshape(draws, rows, -1), best[None, :, None], axis=0)[0], carry


def test_an_actor_with_a_memory_fits():
    actor = ReturnToGo(jnp.asarray(1.0))
    carry, act = actor.begin(2), eqx.filter_jit(lambda actor, carry, rows: actor.act(carry, rows))
    first, carry = act(actor, carry, jnp.zeros((2, 3)))
    carry = actor.observe(carry, jnp.asarray([0.25, -1.0]))
    second, _ = act(actor, carry, jnp.zeros((2, 3)))
    np.testing.assert_allclose(first[:, 0], np.tanh([1.0, 1.0]), rtol=1e-6)
    np.testing.assert_allclose(second[:, 0], np.tanh([0.75, 2.0]), rtol=1e-6)
    np.testing.assert_array_equal(actor.mode(jnp.zeros((2, 3))), first)


def test_an_actor_that_ranks_candidates_fits():
    state = tiny.state_of(EnsembleSAC(**tiny.SMALL))
    draws = tiny.floats(np.random.default_rng(1).normal(size=(7, tiny.ACT_DIM)))
    actor, rows = BestCandidate(state.actor.now, state.online_critics, draws), _rows(5)
    chosen = actor.mode(rows)
    candidates = jnp.stack(
        [state.actor.now.sample(rows, jnp.broadcast_to(draw[None], chosen.shape))[0] for draw in draws]
    )
    values = jnp.stack([jnp.min(state.online_critics(rows, actions), axis=0) for actions in candidates])
    np.testing.assert_allclose(jnp.min(state.online_critics(rows, chosen), axis=0), jnp.max(values, axis=0), rtol=1e-5)
    assert not np.array_equal(chosen, actor.act((), rows, jr.key(0))[0])
