"""OSR's two terms and CQL's term against NumPy."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import inverse, tiny
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.terms import Conservative, InverseDynamicsAlignment, InverseDynamicsValues
from odaf.components.inverse_dynamics import InverseDynamicsConfig, untrained_inverse
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError

KEY = 5
MODEL = InverseDynamicsConfig(hidden_sizes=(5, 4), latent_dim=3)


def _side(encode_target: bool = False):
    config = dataclasses.replace(MODEL, encode_target=encode_target)
    structure = jax.eval_shape(lambda: untrained_inverse(config, jr.key(0), tiny.OBS_DIM, tiny.ACT_DIM))
    return tiny.filled(structure, 4)


def _context(placeholder: bool = False):
    """One of the rows that end may repeat its own state, as where the log ends without a successor."""
    batch = tiny.batch()
    if placeholder:
        after = batch.next_observations.at[2].set(batch.observations[2]).at[3].set(batch.observations[3])
        batch = dataclasses.replace(batch, next_observations=after)
    return tiny.context_of(tiny.state_of(EnsembleSAC(**tiny.SMALL)), batch)


def _check(term, side, context, own: str, expected) -> None:
    """Value and gradient of the term in its own networks, and zero in all others."""

    def loss(networks):
        shown = dataclasses.replace(context, **{own: networks})
        if own == "actor":
            return term.actor_loss(shown, side, jr.key(KEY))[0]
        return term.critic_loss(shown, side, jr.key(KEY))[0]

    networks = getattr(context, own)
    value, gradient = jax.value_and_grad(loss)(networks)
    np.testing.assert_allclose(value, expected(networks), rtol=1e-9)
    tiny.assert_slopes(gradient, expected, networks)
    call = term.actor_loss if own == "actor" else term.critic_loss
    by_context, by_side = eqx.filter_grad(lambda both: call(*both, jr.key(KEY))[0])((context, side))
    for name in {"actor", "critics", "slow_actor", "target_critics"} - {own}:
        assert tiny.all_zero(getattr(by_context, name)), name
    assert tiny.all_zero(by_side)
    assert (term.acts_on_actor, term.acts_on_critics) == (own == "actor", own == "critics")


@pytest.mark.parametrize("encode_target", [False, True])
@pytest.mark.parametrize("placeholder", [False, True])
def test_alignment_follows_its_formula(encode_target, placeholder):
    with tiny.exactly():
        term, side, context = InverseDynamicsAlignment(state_noise=0.3), _side(encode_target), _context(placeholder)
        with tiny.recorded() as drawn:
            loss, metrics = term.actor_loss(context, side, jr.key(KEY))
        np.testing.assert_allclose(0.5 * metrics["inverse_dynamics/divergence"], loss, rtol=1e-12)
        _check(term, side, context, "actor", lambda a: 0.5 * inverse.alignment(a, side, context.batch, 0.3, *drawn))


@pytest.mark.parametrize("placeholder", [False, True])
def test_values_follow_their_formula(placeholder):
    with tiny.exactly():
        term = InverseDynamicsValues(weight=2.0, state_noise=0.3, num_actions=3)
        side, context = _side(), _context(placeholder)
        with tiny.recorded() as drawn:
            loss, metrics = term.critic_loss(context, side, jr.key(KEY))
        np.testing.assert_allclose(2.0 * metrics["inverse_dynamics_values/gap"], loss, rtol=1e-12)

        def expected(critics):
            return 2.0 * inverse.values_gap(critics, context.actor, side, context.batch, 0.3, *drawn)

        _check(term, side, context, "critics", expected)


def test_the_conservative_term_follows_its_formula():
    with tiny.exactly():
        term, context = Conservative(num_actions=3), _context()
        with tiny.recorded("uniform") as uniform, tiny.recorded() as drawn:
            loss, metrics = term.critic_loss(context, (), jr.key(KEY))
        np.testing.assert_allclose(5.0 * 3 * metrics["conservative/gap"], loss, rtol=1e-12)

        def expected(critics):
            return 5.0 * inverse.conservative(critics, context.actor, context.batch, *uniform, *drawn)

        _check(term, (), context, "critics", expected)


def test_the_soft_maximum_is_the_integral_over_actions():
    """Constant critics: log sum of 3 n terms exp(q) / p, whose mean over draws is exp(q) times the volume 2^A."""
    with tiny.exactly():
        context = _context()
        flat = eqx.tree_at(
            lambda c: (c.networks.weights[-1], c.networks.biases[-1]),
            context.critics,
            replace_fn=lambda leaf: jnp.zeros_like(leaf),
        )
        actor = jax.tree.map(lambda leaf: 0.1 * leaf, context.actor)
        term = Conservative(weight=1.0, num_actions=4000)
        loss, _ = term.critic_loss(dataclasses.replace(context, critics=flat, actor=actor), (), jr.key(KEY))
    assert float(loss) == pytest.approx(3 * np.log(3 * 4000 * 2.0**tiny.ACT_DIM), rel=0.01)


def test_a_policy_that_agrees_with_the_model_costs_nothing():
    with tiny.exactly():
        context, side = _context(), _side()
        noise = jnp.zeros((tiny.ROWS, 3))
        mean, log_std = side.parameters(context.batch.observations, context.batch.next_observations, noise)

        def agreeing(self, *_):
            return mean, log_std

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(type(context.actor), "parameters", agreeing)
            patch.setattr(type(side), "draw_noise", lambda *_: noise)
            term = InverseDynamicsAlignment(state_noise=0.0)
            loss, _ = term.actor_loss(context, side, jr.key(KEY))
    assert float(loss) == pytest.approx(0.0, abs=1e-14)


def test_pretraining_fits_the_model_that_the_term_will_use():
    dataset = tiny.linear_dataset(episodes=4, length=10)
    model = dataclasses.replace(MODEL, steps=3)
    learner = EnsembleSAC(
        **tiny.SMALL, terms=(InverseDynamicsAlignment(model=model), InverseDynamicsValues(model=model))
    )
    calls = []
    sides, report = learner.pretrain(
        dataset, Normaliser.fit(dataset.observations), jr.key(0), lambda *call: calls.append(call)
    )
    blank = jax.eval_shape(lambda: learner.untrained(jr.key(1), dataset.spec()))
    assert jax.tree.structure(sides) == jax.tree.structure(blank)
    assert calls == 2 * [("inverse-dynamics model", 3, 3)]
    for name in ("inverse_dynamics", "inverse_dynamics_values"):
        assert report[name]["holdout_rows"] == 10
        assert any(f"{name}.model.steps" in warning for warning in report["warnings"])


@pytest.mark.parametrize(
    ("term", "fields", "message"),
    [
        (InverseDynamicsAlignment, {"weight": -1.0}, "inverse_dynamics.weight=-1.0"),
        (InverseDynamicsAlignment, {"state_noise": -1.0}, "inverse_dynamics.state_noise=-1.0"),
        (InverseDynamicsValues, {"weight": -1.0}, "inverse_dynamics_values.weight=-1.0"),
        (InverseDynamicsValues, {"num_actions": 0}, "inverse_dynamics_values.num_actions=0"),
        (Conservative, {"num_actions": 0}, "conservative: num_actions=0"),
        (Conservative, {"weight": -2.0}, "weight=-2.0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(term, fields, message):
    with pytest.raises(ConfigError, match=message):
        term(**fields)
