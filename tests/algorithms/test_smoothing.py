"""RORL's two smoothing terms against NumPy and against the naive maximum."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import smoothing, tiny
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.terms import PolicySmoothing, ValueSmoothing
from odaf.algorithms.terms.policy_smoothing import policy_change
from odaf.components.perturbations import draw_offsets
from odaf.errors import ConfigError

KEY = 7
TERMS = {"policy": (PolicySmoothing, "actor"), "value": (ValueSmoothing, "critics")}
each_term = pytest.mark.parametrize("which", TERMS)
each_sharing = pytest.mark.parametrize("shared", [False, True], ids=["own draws", "shared draws"])


def _context(norm: str = "layer"):
    return tiny.context_of(tiny.state_of(EnsembleSAC(**{**tiny.SMALL, "critic_norm": norm})), tiny.batch())


def _term(which: str, **fields):
    return TERMS[which][0](**{"weight": 0.7, "radius": 0.1, "num_draws": 5, **fields})


def _loss(term, context, networks):
    """The term's loss as a function of the networks that it acts on."""
    if isinstance(term, PolicySmoothing):
        return term.actor_loss(dataclasses.replace(context, actor=networks), (), jr.key(KEY))
    return term.critic_loss(dataclasses.replace(context, critics=networks), (), jr.key(KEY))


def _offsets(term):
    return draw_offsets(
        jr.key(KEY),
        term.num_draws,
        tiny.ROWS,
        tiny.OBS_DIM,
        term.radius,
        shared=term.shared_draws,
        include_centre=False,
    )


def _changes(term, context, networks) -> np.ndarray:
    states, offsets = context.batch.observations, _offsets(term)
    if isinstance(term, PolicySmoothing):
        return smoothing.policy_changes(networks, states, offsets)
    return smoothing.value_changes(networks, states, context.batch.actions, offsets, term.fall_weight)


@each_term
@each_sharing
def test_value_and_gradient_follow_the_formula(which, shared):
    with tiny.exactly():
        term, context = _term(which, shared_draws=shared), _context()
        networks = getattr(context, TERMS[which][1])

        def expected(networks):
            return 0.7 * smoothing.worst(_changes(term, context, networks))

        (loss, metrics), gradient = jax.value_and_grad(lambda n: _loss(term, context, n), has_aux=True)(networks)
        np.testing.assert_allclose(loss, expected(networks), rtol=1e-9)
        np.testing.assert_allclose(metrics[f"{term.name}/loss"], loss / 0.7, rtol=1e-12)
        np.testing.assert_allclose(metrics[f"{term.name}/max"], _changes(term, context, networks).max(), rtol=1e-9)
        tiny.assert_slopes(gradient, expected, networks, rtol=1e-4)
        winners = np.argmax(_changes(term, context, networks), axis=0)
        assert len(set(winners)) > 1, "states must disagree on the worst draw, or a wrong index goes unseen"


@pytest.mark.parametrize("fall_weight", [0.0, 0.5, 1.0])
def test_rises_and_falls_are_weighted_apart(fall_weight):
    with tiny.exactly():
        term, context = _term("value", fall_weight=fall_weight), _context()
        expected = 0.7 * smoothing.worst(_changes(term, context, context.critics))
        np.testing.assert_allclose(_loss(term, context, context.critics)[0], expected, rtol=1e-9)


def _naive(term, context, networks):
    """The maximum over all draws, differentiated through every one of them."""
    states, actions = context.batch.observations, context.batch.actions
    if isinstance(term, PolicySmoothing):
        here = networks.parameters(states)
        changes = [policy_change(here, networks.parameters(states + offset)) for offset in _offsets(term)]
    else:
        changes = [
            term.change(networks(states, actions), networks(states + offset, actions)) for offset in _offsets(term)
        ]
    return term.weight * jnp.mean(jnp.max(jnp.stack(changes), axis=0))


@pytest.mark.parametrize(("which", "norm"), [("policy", "layer"), ("value", "layer"), ("value", "none")])
def test_choosing_first_gives_the_gradient_of_the_naive_maximum(which, norm):
    with tiny.exactly():
        term, context = _term(which), _context(norm)
        networks = getattr(context, TERMS[which][1])
        naive_value, naive_gradient = jax.value_and_grad(lambda n: _naive(term, context, n))(networks)
    with jax.enable_x64(True):
        value, gradient = jax.jit(jax.value_and_grad(lambda n: _loss(term, context, n)[0]))(networks)
    np.testing.assert_allclose(value, naive_value, rtol=1e-10)
    largest = max(float(np.max(np.abs(leaf))) for leaf in jax.tree.leaves(naive_gradient))
    assert largest > 1e-4, "a gradient of nothing proves nothing"
    tiny.assert_close(gradient, naive_gradient, atol=1e-9 * largest)


@each_term
def test_the_gradient_reaches_its_own_networks_and_nothing_else(which):
    term, own = _term(which), TERMS[which][1]
    with tiny.exactly():
        context = _context()
        gradient = eqx.filter_grad(lambda c: _loss(term, c, getattr(c, own))[0])(context)
    assert tiny.each_nonzero(
        getattr(gradient, own).network.weights if own == "actor" else gradient.critics.networks.weights
    )
    for name in {"actor", "critics", "slow_actor", "target_critics"} - {own}:
        assert tiny.all_zero(getattr(gradient, name)), name
    assert (term.acts_on_actor, term.acts_on_critics) == (own == "actor", own == "critics")


def test_values_are_averaged_over_members():
    with tiny.exactly():
        term, context = _term("value"), _context()
        doubled = jax.tree.map(lambda leaf: jnp.concatenate([leaf, leaf]), context.critics)
        one, two = (float(_loss(term, context, critics)[0]) for critics in (context.critics, doubled))
    assert two == pytest.approx(one, rel=1e-12)


@each_term
def test_a_box_of_size_zero_costs_nothing(which):
    with tiny.exactly():
        term, context = _term(which, radius=0.0), _context()
        (loss, _), gradient = jax.value_and_grad(lambda n: _loss(term, context, n), has_aux=True)(
            getattr(context, TERMS[which][1])
        )
    assert float(loss) == 0.0 and tiny.all_zero(gradient)


@each_term
@pytest.mark.parametrize("fields", [{"num_draws": 0}, {"radius": -0.5}, {"weight": -1.0}], ids=str)
def test_settings_that_make_no_sense_are_refused(which, fields):
    ((field, value),) = fields.items()
    with pytest.raises(ConfigError, match=f"{which}_smoothing: .*{field}={value}"):
        _term(which, **fields)


def test_a_share_outside_of_the_unit_interval_is_refused():
    with pytest.raises(ConfigError, match="fall_weight=1.5 must lie in"):
        _term("value", fall_weight=1.5)
