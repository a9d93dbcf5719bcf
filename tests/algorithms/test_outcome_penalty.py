"""ODAF's term against Algorithm 1 in NumPy, option by option, and against the naive maximum."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import dynamics, networks, outcome, tiny
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.terms import OutcomePenalty
from odaf.components.perturbations import draw_offsets
from odaf.components.targets import frozen
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError

KEY = 11
OPTIONS = {
    "default": {},
    "three ascent steps": {"ascent_steps": 3},
    "as printed": {"solver": "sample", "dynamics": {"kind": "cvae", "residual": False}},
    "mean over draws": {"solver": "sample", "reduce": "mean"},
    "centre among the draws": {"solver": "sample", "include_centre": True},
    "one noise for all draws": {"solver": "sample", "common_noise": True},
    "one set of draws for the batch": {"solver": "sample", "shared_draws": True},
    "current policy acts next": {"next_policy": "current"},
    "next action without noise": {"next_action": "mode"},
    "next action at the perturbed state": {"next_action_at": "perturbed"},
    "divisor K - 1": {"std_ddof": 1},
    "some of the states": {"num_states": 4},
    "some of the states, sampled": {"num_states": 4, "solver": "sample"},
    "dynamics ensemble": {"dynamics": {"kind": "ensemble"}},
    "dynamics ensemble, sampled": {"solver": "sample", "dynamics": {"kind": "ensemble"}},
    "cvae that sees the target": {"dynamics": {"kind": "cvae", "encoder": "transition"}},
    "box of size zero": {"radius": 0.0},
}
each_option = pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)


@pytest.mark.parametrize("kind", ["deterministic", "ensemble"])
@pytest.mark.parametrize("next_action", ["sample", "mode"])
def test_the_target_loses_the_uncertainty_of_the_next_actions_outcome(kind, next_action):
    """Of every row, whatever num_states, at the state itself, by the slow critics."""
    with tiny.exactly():
        options = {"target_weight": 0.7, "next_action": next_action, "num_states": 4, "dynamics": {"kind": kind}}
        term, context, side = _setting(options)
        actions = jr.uniform(jr.key(2), (tiny.ROWS, tiny.ACT_DIM), minval=-1.0)
        found = term.target_penalty(context, side, actions, jnp.zeros(tiny.ROWS), jr.key(KEY))
        _, for_model, for_action = term._draw_noise(context, side, tiny.ROWS, jr.key(KEY))
        outcomes = dynamics.PREDICT[kind](side, networks.numbers(context.batch.next_observations), actions, for_model)
        then = networks.mode(context.slow_actor, outcomes)
        if next_action == "sample":
            then, _ = networks.act(context.slow_actor, outcomes, for_action)
        expected = 0.7 * networks.spread(networks.q_values(context.target_critics, outcomes, then), 0)
        np.testing.assert_allclose(found, expected, rtol=1e-8)
        assert np.all(found > 0.0)
        off = dataclasses.replace(term, target_weight=0.0)
        assert not np.any(off.target_penalty(context, side, actions, jnp.zeros(tiny.ROWS), jr.key(KEY)))


def _setting(options, norm="layer"):
    """The term, its context and its dynamics model, all with random numbers everywhere."""
    config = tiny.dynamics_config(**options.get("dynamics", {}))
    term = OutcomePenalty(**{"radius": 0.1, "num_draws": 4, **options, "dynamics": config})
    state = tiny.state_of(EnsembleSAC(**{**tiny.SMALL, "critic_norm": norm}))
    return term, tiny.context_of(state, tiny.batch()), tiny.dynamics_model(config, 5)


def _draws(term, context, side, key):
    """The offsets and the noise of all draws for the sample solver, the noise alone for the gradient solver."""
    rows = tiny.ROWS if term.num_states is None else term.num_states
    key_noise, key_offsets = jr.split(key)
    if term.solver == "gradient":
        return np.zeros(0), [term._draw_noise(context, side, rows, key_noise)]
    centre = term.include_centre
    offsets = draw_offsets(
        key_offsets, term.num_draws, rows, tiny.OBS_DIM, term.radius, shared=term.shared_draws, include_centre=centre
    )
    if term.common_noise:
        return offsets, [term._draw_noise(context, side, rows, key_noise)] * term.num_draws
    return offsets, [term._draw_noise(context, side, rows, k) for k in jr.split(key_noise, term.num_draws)]


def _expected(term, context, side, key, actor=None) -> np.ndarray:
    """The term before its weight and the mean over states; `actor` differs from the context's for derivatives."""

    def u(perturbed, noise):
        return outcome.uncertainty(
            perturbed,
            context.actor if actor is None else actor,
            context.slow_actor if term.next_policy == "slow" else context.actor,
            context.critics,
            functools.partial(dynamics.PREDICT[term.dynamics.kind], side),
            noise,
            next_action=term.next_action,
            next_action_at=term.next_action_at,
            ddof=term.std_ddof,
        )

    states = networks.numbers(context.batch.observations)[: term.num_states]
    offsets, noises = _draws(term, context, side, key)
    if term.solver == "gradient":
        return outcome.ascend(states, noises[0], u, term.radius, term.ascent_steps)
    return outcome.worst_of_draws(states, offsets, noises, u, term.reduce)


@each_option
def test_every_option_follows_algorithm_1(options):
    with tiny.exactly():
        term, context, side = _setting(options)
        found = term.worst_case(context, side, jr.key(KEY))
        expected = _expected(term, context, side, jr.key(KEY))
        assert found.shape == (options.get("num_states", tiny.ROWS),)
        np.testing.assert_allclose(found, expected, rtol=1e-8)

        def loss(actor):
            return term.actor_loss(dataclasses.replace(context, actor=actor), side, jr.key(KEY))

        (value, metrics), gradient = jax.value_and_grad(loss, has_aux=True)(context.actor)
        np.testing.assert_allclose(value, 0.3 * expected.mean(), rtol=1e-8)
        np.testing.assert_allclose(metrics["outcome/uncertainty"], expected.mean(), rtol=1e-8)
        np.testing.assert_allclose(metrics["outcome/uncertainty/max"], expected.max(), rtol=1e-8)
        tiny.assert_slopes(
            gradient,
            lambda actor: 0.3 * _expected(term, context, side, jr.key(KEY), actor).mean(),
            context.actor,
            rtol=1e-4,
        )


def test_a_detached_next_action_leaves_the_direct_path_only():
    with tiny.exactly():
        term, context, side = _setting({"radius": 0.0, "detach_next_action": True})
        _, (noise,) = _draws(term, context, side, jr.key(KEY))
        predict = functools.partial(dynamics.deterministic, side)
        states = networks.numbers(context.batch.observations)
        reached = predict(states, networks.act(context.actor, states, noise[0])[0])
        held, _ = networks.act(context.slow_actor, reached, noise[2])

        def expected(actor):
            return outcome.uncertainty(
                states, actor, context.slow_actor, context.critics, predict, noise, fixed_next_action=held
            ).mean()

        def gradient_of(term):
            def loss(actor):
                return jnp.mean(term.worst_case(dataclasses.replace(context, actor=actor), side, jr.key(KEY)))

            return jax.grad(loss)(context.actor)

        tiny.assert_slopes(gradient_of(term), expected, context.actor)
        attached = gradient_of(dataclasses.replace(term, detach_next_action=False))
        with pytest.raises(AssertionError):  # otherwise this setting could not tell the two apart
            tiny.assert_slopes(attached, expected, context.actor, rtol=1e-3)


def _naive(term, context, side, key):
    """The maximum over all draws, differentiated through every one of them."""
    offsets, noises = _draws(term, context, side, key)
    constant = dataclasses.replace(
        context,
        critics=frozen(context.critics),
        slow_actor=frozen(context.slow_actor),
        target_critics=frozen(context.target_critics),
    )
    states = context.batch.observations
    values = [
        term.outcome_uncertainty(constant, context.actor, frozen(side), states + offset, noise)
        for offset, noise in zip(offsets, noises, strict=True)
    ]
    return jnp.mean(jnp.max(jnp.stack(values), axis=0))


@pytest.mark.parametrize(
    ("kind", "norm", "compiled"),
    [
        ("deterministic", "layer", True),
        ("deterministic", "none", False),
        ("cvae", "layer", False),
        ("ensemble", "none", False),
    ],
)
def test_choosing_first_gives_the_gradient_of_the_naive_maximum(kind, norm, compiled):
    options = {"solver": "sample", "num_draws": 6, "weight": 1.0, "dynamics": {"kind": kind}}
    with tiny.exactly():
        term, context, side = _setting(options, norm)

        def chosen(actor):
            return term.actor_loss(dataclasses.replace(context, actor=actor), side, jr.key(KEY))[0]

        def naive(actor):
            return _naive(term, dataclasses.replace(context, actor=actor), side, jr.key(KEY))

        naive_value, naive_gradient = jax.value_and_grad(naive)(context.actor)
    with jax.enable_x64(True) if compiled else tiny.exactly():
        solve = jax.value_and_grad(chosen)
        value, gradient = (jax.jit(solve) if compiled else solve)(context.actor)
    np.testing.assert_allclose(value, naive_value, rtol=1e-10)
    largest = max(float(np.max(np.abs(leaf))) for leaf in jax.tree.leaves(naive_gradient))
    assert largest > 1e-3, "a gradient of nothing proves nothing"
    tiny.assert_close(gradient, naive_gradient, atol=1e-8 * largest)


@eqx.filter_jit
def _gains(term, context, side, offsets):
    """Mean increase of U over its value at the state itself: by one signed step, and by the best of the offsets."""
    states = context.batch.observations
    noise = term._draw_noise(context, side, len(states), jr.split(jr.key(KEY))[0])  # as `worst_case` of KEY

    def u(offset):
        return term.outcome_uncertainty(context, context.actor, side, states + offset, noise)

    centre = u(jnp.zeros_like(states))
    climbed = term.worst_case(context, side, jr.key(KEY)) - centre
    return climbed.mean(), jax.vmap(u)(offsets).max(axis=0).mean() - centre.mean()


def test_the_gradient_solver_finds_more_than_draws_do():
    """Both judge the same noise, so that only the offsets differ."""
    term = OutcomePenalty(radius=0.05, dynamics=tiny.dynamics_config(hidden_sizes=(16,)))
    gains = []
    with tiny.exactly():
        state = tiny.state_of(EnsembleSAC(num_critics=4, hidden_sizes=(16, 16)), size=0.3)
        for seed in range(5):
            critics = tiny.filled(state.online_critics, 100 + seed, 0.3)
            actor = tiny.filled(state.actor.now, 200 + seed, 0.3)
            context = tiny.context_of(state, tiny.batch(64, seed))
            context = dataclasses.replace(context, critics=critics, actor=actor, slow_actor=actor)
            offsets = np.random.default_rng(seed).uniform(-term.radius, term.radius, (20, 64, tiny.OBS_DIM))
            side = tiny.dynamics_model(term.dynamics, seed, 0.3)
            gains.append([float(gain) for gain in _gains(term, context, side, tiny.floats(offsets))])
    gains = np.array(gains)
    assert np.all(gains > 0.0)
    assert gains[:, 0].mean() >= gains[:, 1].mean()


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"solver": "sample"},
        {"solver": "sample", "reduce": "mean"},
        {"next_policy": "current"},
        {"detach_next_action": True},
        {"dynamics": {"kind": "cvae"}},
        {"dynamics": {"kind": "ensemble"}},
    ],
    ids=str,
)
def test_the_gradient_reaches_the_actor_and_nothing_else(options):
    with tiny.exactly():
        term, context, side = _setting(options)
        by_context, by_side = eqx.filter_grad(lambda both: term.actor_loss(both[0], both[1], jr.key(KEY))[0])(
            (context, side)
        )
    assert tiny.each_nonzero(by_context.actor)
    for name in ("critics", "target_critics", "slow_actor", "value_bounds"):
        assert tiny.all_zero(getattr(by_context, name)), name
    assert tiny.all_zero(by_side)


def test_the_critics_hear_nothing_of_the_term():
    term, context, side = _setting({})
    loss, metrics = term.critic_loss(context, side, jr.key(KEY))
    assert float(loss) == 0.0 and metrics == {} and not term.acts_on_critics and term.acts_on_actor


def test_a_larger_box_holds_a_larger_worst_case():
    """With one noise, and boxes in which a piecewise smooth U is nearly linear, so that the corner is the maximum."""
    with tiny.exactly():
        term, context, side = _setting({"solver": "gradient"})
        worst = [
            np.asarray(dataclasses.replace(term, radius=radius).worst_case(context, side, jr.key(KEY)))
            for radius in (0.0, 1e-4, 2e-4)
        ]
    assert np.all(worst[0] < worst[1]) and np.all(worst[1] < worst[2])


def test_without_a_box_the_two_solvers_agree_only_on_one_noise():
    """Draws of their own noise make the worst case one over noise: it rises where there is no box at all."""
    with tiny.exactly():
        term, context, side = _setting({"radius": 0.0})
        one = term.worst_case(context, side, jr.key(KEY))
        sampled = dataclasses.replace(term, solver="sample", num_draws=8)
        common = dataclasses.replace(sampled, common_noise=True).worst_case(context, side, jr.key(KEY))
        own = np.asarray(sampled.worst_case(context, side, jr.key(KEY)))
        mean = np.asarray(dataclasses.replace(sampled, reduce="mean").worst_case(context, side, jr.key(KEY)))
    np.testing.assert_allclose(common, one, rtol=1e-9)
    assert np.all(own - mean > 1e-3), "the worst of draws that differ in noise alone lies above their mean"


def test_pretraining_fits_the_model_that_the_term_will_use():
    dataset = tiny.linear_dataset(episodes=4, length=10)
    learner = EnsembleSAC(**tiny.SMALL, terms=(OutcomePenalty(dynamics=tiny.dynamics_config(steps=3)),))
    calls = []
    models, report = learner.pretrain(
        dataset, Normaliser.fit(dataset.observations), jr.key(0), lambda *call: calls.append(call)
    )
    blank = jax.eval_shape(lambda: learner.untrained(jr.key(1), dataset.spec()))
    assert jax.tree.structure(models) == jax.tree.structure(blank)
    assert calls == [("dynamics model", 3, 3)]
    assert report["outcome"]["kind"] == "deterministic" and report["outcome"]["holdout_rows"] == 10
    assert len(report["warnings"]) == 1 and "no better than predicting 'no change'" in report["warnings"][0]
    state = learner.init(jr.key(0), dataset.spec(), models)
    assert state.terms == models.terms


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"reduce": "mean"}, "outcome.reduce='mean' averages over draws.*set outcome.solver='sample'"),
        ({"radius": -0.1}, "outcome.radius=-0.1"),
        ({"weight": -1.0}, "outcome.weight=-1.0"),
        ({"num_draws": 0}, "outcome.num_draws=0"),
        ({"ascent_steps": 0}, "outcome.ascent_steps=0"),
        ({"num_states": 0}, "outcome.num_states=0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(fields, message):
    with pytest.raises(ConfigError, match=message):
        OutcomePenalty(**fields)
