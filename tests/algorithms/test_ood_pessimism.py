"""The pessimistic term in RORL's and in PBRL's form, against NumPy."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import networks, pessimism, tiny
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.terms import OODPessimism
from odaf.errors import ConfigError

RORL = {"weight": 0.5, "num_actions": 3, "radius": 0.05, "deviations": 2.0, "std_ddof": 1}
FORMS = {
    "RORL": RORL,
    "RORL with shared draws": {**RORL, "shared_draws": True},
    "PBRL": {"weight": 1.0, "num_actions": 2, "deviations": 5.0, "next_deviations": 0.1, "floor": 0.0, "std_ddof": 1},
    "plain": {},
}


def _context(bounds=(-np.inf, np.inf), size: float = 0.6):
    return tiny.context_of(tiny.state_of(EnsembleSAC(**tiny.SMALL), bounds=bounds, size=size), tiny.batch())


def _expected(term, context, offsets, normals, critics=None, fixed_critics=None) -> float:
    """The weighted loss for recorded draws; first those at the states, then those at the next states."""

    def at(states, offset, noise, deviations):
        return pessimism.pull_down(
            context.critics if critics is None else critics,
            context.actor,
            pessimism.repeated(states, np.broadcast_to(offset, (term.num_actions, tiny.ROWS, tiny.OBS_DIM))),
            noise,
            deviations,
            ddof=term.std_ddof,
            floor=term.floor,
            bounds=networks.numbers(context.value_bounds),
            fixed_critics=fixed_critics,
        )

    losses = [at(context.batch.observations, offsets[0], normals[0], term.deviations)]
    if term.next_deviations is not None:
        losses.append(at(context.batch.next_observations, offsets[1], normals[1], term.next_deviations))
    assert len(normals) == len(offsets) == len(losses)
    return term.weight * float(np.mean(losses))


def _with_draws(term, context):
    with tiny.recorded("uniform") as offsets, tiny.recorded("normal") as normals:
        loss, metrics = term.critic_loss(context, (), jr.key(3))
    return loss, metrics, offsets, normals


@pytest.mark.parametrize("at_once", [1, 512])
@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_both_papers_forms_follow_their_formula(form, at_once, monkeypatch):
    monkeypatch.setattr("odaf.components.chunks.ROWS_AT_ONCE", at_once)
    with tiny.exactly():
        term, context = OODPessimism(**form), _context()
        loss, metrics, offsets, normals = _with_draws(term, context)
        np.testing.assert_allclose(loss, _expected(term, context, offsets, normals), rtol=1e-9)
        np.testing.assert_allclose(term.weight * metrics["ood/loss"], loss, rtol=1e-12)
        assert np.abs(offsets[0]).max() <= term.radius
        assert len(np.unique(offsets[0][0], axis=0)) == (1 if term.shared_draws else tiny.ROWS if term.radius else 1)

        gradient = jax.grad(
            lambda critics: term.critic_loss(dataclasses.replace(context, critics=critics), (), jr.key(3))[0]
        )(context.critics)
        tiny.assert_slopes(
            gradient,
            lambda critics: _expected(term, context, offsets, normals, critics, context.critics),
            context.critics,
        )


def test_targets_stay_inside_the_value_range():
    with tiny.exactly():
        term, context = OODPessimism(deviations=20.0), _context(bounds=(-2.0, 4.0))
        loss, _, offsets, normals = _with_draws(term, context)
        np.testing.assert_allclose(loss, _expected(term, context, offsets, normals), rtol=1e-9)
        free = dataclasses.replace(context, value_bounds=tiny.floats([-np.inf, np.inf]))
        assert float(term.critic_loss(free, (), jr.key(3))[0]) > 1.5 * float(loss), "the bound must bite here"


def test_the_loss_averages_over_members_where_the_bellman_loss_sums():
    learner = EnsembleSAC(**tiny.SMALL)
    losses, sums = [], []
    with tiny.exactly():
        state, batch = tiny.state_of(learner), tiny.batch()
        doubled = jax.tree.map(lambda leaf: jnp.concatenate([leaf, leaf]), state.online_critics)
        for critics in (state.online_critics, doubled):
            context = dataclasses.replace(tiny.context_of(state, batch), critics=critics)
            losses.append(float(OODPessimism().critic_loss(context, (), jr.key(3))[0]))
            shown = dataclasses.replace(state, critics=dataclasses.replace(state.critics, now=critics.networks))
            _, metrics = learner.critic_gradient(shown, batch, jr.key(4))
            sums.append(float(metrics["critic/loss"]))
    assert losses[1] == pytest.approx(losses[0], rel=1e-9)
    assert sums[1] == pytest.approx(2.0 * sums[0], rel=1e-9)


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS)
def test_the_gradient_reaches_the_critics_and_nothing_else(form):
    term = OODPessimism(**form)
    with tiny.exactly():
        context = _context()
        gradient = eqx.filter_grad(lambda c: term.critic_loss(c, (), jr.key(3))[0])(context)
    assert tiny.each_nonzero(gradient.critics.networks.weights)
    for name in ("actor", "slow_actor", "target_critics"):
        assert tiny.all_zero(getattr(gradient, name)), name
    assert not term.acts_on_actor and float(term.actor_loss(context, (), jr.key(3))[0]) == 0.0


def test_descending_the_loss_lowers_the_critics_where_the_policy_acts():
    term = OODPessimism(weight=1.0)

    def loss(critics):
        return term.critic_loss(dataclasses.replace(context, critics=critics), (), jr.key(3))[0]

    with tiny.exactly(), tiny.recorded() as noise:
        context = _context()
        gradient = jax.grad(loss)(context.critics)
    states = context.batch.observations
    actions, _ = networks.act(context.actor, states, noise[0])
    lower = jax.tree.map(lambda p, g: np.asarray(p) - 1e-3 * np.asarray(g), context.critics, gradient)
    before, after = (networks.q_values(critics, states, actions) for critics in (context.critics, lower))
    assert after.mean() < before.mean()


@pytest.mark.parametrize(
    ("first", "last", "steps", "expected"),
    [
        (2.0, 0.5, 100, {0: 2.0, 50: 1.25, 100: 0.5, 101: 0.5, 10_000: 0.5}),
        (0.1, 1.0, 10, {0: 0.1, 5: 0.55, 10: 1.0, 50: 1.0}),
        (1.5, 9.0, 0, {0: 1.5, 1000: 1.5}),
    ],
)
def test_deviations_go_to_their_final_value_and_stop_there(first, last, steps, expected):
    term = OODPessimism(deviations=first, final_deviations=last, decay_steps=steps)
    for step, value in expected.items():
        assert float(term.deviations_at(jnp.asarray(step))) == pytest.approx(value, rel=1e-6)


def test_the_decay_reaches_the_loss():
    decaying = OODPessimism(deviations=2.0, final_deviations=0.5, decay_steps=100)
    for step, constant in ((0, 2.0), (500, 0.5)):
        with tiny.exactly():
            context = dataclasses.replace(_context(), step=jnp.asarray(step))
            expected, _ = OODPessimism(deviations=constant).critic_loss(context, (), jr.key(3))
            found, metrics = decaying.critic_loss(context, (), jr.key(3))
        assert float(found) == pytest.approx(float(expected), rel=1e-6)
        assert float(metrics["ood/deviations"]) == constant


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"num_actions": 0}, "num_actions=0"),
        ({"radius": -1.0}, "radius=-1.0"),
        ({"decay_steps": -1}, "decay_steps=-1"),
        ({"weight": -0.5}, "weight=-0.5"),
    ],
)
def test_settings_that_make_no_sense_are_refused(fields, message):
    with pytest.raises(ConfigError, match=message):
        OODPessimism(**fields)
