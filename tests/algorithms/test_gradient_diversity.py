"""EDAC's term: its value against NumPy, its hand-made gradient against second-order differentiation."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import diversity, tiny
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.terms import GradientDiversity
from odaf.algorithms.terms.gradient_diversity import action_diversity, mean_similarity
from odaf.errors import ConfigError

each_norm = pytest.mark.parametrize("norm", ["none", "layer"])


def _context(norm: str, prior_scale: float = 0.0):
    learner = EnsembleSAC(**{**tiny.SMALL, "critic_norm": norm, "prior_scale": prior_scale})
    return tiny.context_of(tiny.state_of(learner), tiny.batch())


def _loss(term, context):
    def loss(critics):
        return term.critic_loss(dataclasses.replace(context, critics=critics), (), jr.key(0))[0]

    return loss


@each_norm
def test_value_and_gradient_follow_the_formula(norm):
    term = GradientDiversity(weight=2.5)
    with tiny.exactly():
        context = _context(norm)
        loss, metrics = term.critic_loss(context, (), jr.key(0))
        batch = context.batch

        def expected(critics):
            return 2.5 * diversity.diversity(critics, batch.observations, batch.actions)

        np.testing.assert_allclose(loss, expected(context.critics), rtol=1e-9)
        np.testing.assert_allclose(metrics["diversity/loss"], loss / 2.5, rtol=1e-12)
        np.testing.assert_allclose(metrics["diversity/cosine"], loss / 2.5 / 3, rtol=1e-12)
        gradient = jax.grad(_loss(term, context))(context.critics)
        tiny.assert_slopes(gradient, expected, context.critics)


def _textbook(critics, observations, actions):
    """The formula as it stands: a Jacobian a row, pairs by a matrix of inner products."""

    def value(critic, observation, action):
        return critic.value(jnp.concatenate([observation, action])[None])[0]

    slope = jax.vmap(jax.grad(value, argnums=2), in_axes=(None, 0, 0))
    slopes = jax.vmap(slope, in_axes=(0, None, None))(critics, observations, actions)
    directions = slopes / (jnp.linalg.norm(slopes, axis=-1, keepdims=True) + 1e-10)
    products = jnp.einsum("iba,jba->bij", directions, directions)
    members = products.shape[-1]
    pairs = jnp.sum(products * (1.0 - jnp.eye(members))[None], axis=(1, 2))
    return jnp.mean(pairs) / (members - 1)


@pytest.mark.parametrize(("norm", "prior_scale"), [("none", 0.0), ("layer", 0.0), ("layer", 2.0)])
@pytest.mark.parametrize("mapped", ["member by member", "all at once"])
def test_the_gradient_is_that_of_plain_second_order_differentiation(norm, prior_scale, mapped, monkeypatch):
    """Of the whole Q-functions: fixed priors turn their slopes too."""
    if mapped == "all at once":  # as on an accelerator
        monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    with jax.enable_x64(True):
        context = _context(norm, prior_scale)
        critics, batch = context.critics, context.batch
        solve = jax.jit(jax.value_and_grad(lambda n: 3.0 * action_diversity(n, batch.observations, batch.actions)))
        plain = jax.jit(jax.value_and_grad(lambda n: 3.0 * _textbook(n, batch.observations, batch.actions)))
        (value, gradient), (plain_value, plain_gradient) = solve(critics), plain(critics)
    np.testing.assert_allclose(value, plain_value, rtol=1e-12)
    largest = max(float(np.max(np.abs(leaf))) for leaf in jax.tree.leaves(plain_gradient))
    assert largest > 1e-2, "a gradient of nothing proves nothing"
    tiny.assert_close(gradient, plain_gradient, atol=1e-11 * largest)


@pytest.mark.parametrize(
    ("slopes", "expected"),
    [
        ([[3.0, 0.0], [0.5, 0.0], [9.0, 0.0]], 3.0),  # one direction, whatever the lengths: K
        ([[1.0, 0.0], [0.0, 2.0]], 0.0),
        ([[1.0, 0.0], [-5.0, 0.0]], -2.0),  # opposite: -K/(K - 1)
        ([[1.0, 0.0], [-0.5, 0.75**0.5], [-0.5, -(0.75**0.5)]], -1.5),  # a star of three sums to zero
        ([[0.0, 0.0], [1.0, 0.0]], 0.0),
    ],
    ids=["parallel", "orthogonal", "opposite", "star", "one without a slope"],
)
def test_similarity_of_known_slopes(slopes, expected):
    with jax.enable_x64(True):
        stack = tiny.floats(slopes)[:, None, :]
        assert float(mean_similarity(stack)) == pytest.approx(expected, abs=1e-8)
        assert np.all(np.isfinite(jax.grad(mean_similarity)(stack)))


def test_dead_members_give_numbers():
    """A network whose units are all off has slope zero; nothing may become infinite."""
    context = _context("none")
    off = eqx.tree_at(lambda c: c.networks.biases[0], context.critics, replace_fn=lambda b: b.at[0].set(-1e3))
    value, gradient = jax.value_and_grad(_loss(GradientDiversity(), context))(off)
    assert np.isfinite(value)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradient))
    assert tiny.all_zero(jax.tree.map(lambda leaf: leaf[0], gradient)) and not tiny.all_zero(gradient)


@each_norm
def test_descending_the_loss_turns_slopes_apart(norm):
    with tiny.exactly():
        context = _context(norm)
        loss = _loss(GradientDiversity(), context)
        gradient = jax.grad(loss)(context.critics)
        lower = jax.tree.map(lambda p, g: p - 1e-3 * g, context.critics, gradient)
        assert float(loss(lower)) < float(loss(context.critics))


@each_norm
def test_the_gradient_reaches_the_critics_and_nothing_else(norm):
    term = GradientDiversity()
    with tiny.exactly():
        context = _context(norm)
        gradient = eqx.filter_grad(lambda c: term.critic_loss(c, (), jr.key(0))[0])(context)
    assert tiny.each_nonzero(gradient.critics.networks.weights)
    assert tiny.all_zero(gradient.critics.networks.biases[-1]), "a constant has no slope"
    for name in ("actor", "slow_actor", "target_critics", "batch"):
        assert tiny.all_zero(getattr(gradient, name)), name
    assert not term.acts_on_actor and float(term.actor_loss(context, (), jr.key(0))[0]) == 0.0


def test_slopes_are_compared_in_full_precision_where_critics_round_their_products():
    context = _context("none")
    rounding = dataclasses.replace(
        context.critics, networks=dataclasses.replace(context.critics.networks, products="bfloat16")
    )
    loss = _loss(GradientDiversity(), context)
    found, expected = (jax.value_and_grad(loss)(critics) for critics in (rounding, context.critics))
    assert float(found[0]) == float(expected[0])
    for here, there in zip(jax.tree.leaves(found[1]), jax.tree.leaves(expected[1]), strict=True):
        np.testing.assert_array_equal(here, there)


def test_a_negative_weight_is_refused():
    with pytest.raises(ConfigError, match="diversity.weight=-1.0"):
        GradientDiversity(weight=-1.0)
