"""`odaf-demo` against the released code's losses, derived anew in NumPy, on fixed tensors."""

import functools
from typing import Any

import jax
import jax.random as jr
import numpy as np

from golden import dynamics, released_code, tiny
from odaf.algorithms import config
from odaf.algorithms.ensemble_sac import EnsembleSAC, _key_for
from odaf.components.perturbations import draw_offsets
from odaf.runs import presets

DRAWS = 3
KEY = 5
SMALL = {
    **tiny.SMALL,
    "policy_smoothing.num_draws": DRAWS,
    "value_smoothing.num_draws": DRAWS,
    "ood.num_actions": DRAWS,
    "outcome.num_draws": DRAWS,
    "outcome.dynamics.hidden_sizes": (5, 4),
    "outcome.dynamics.latent_dim": 3,
    # boxes wide enough, and a weight large enough, for a mistake to show
    "policy_smoothing.radius": 0.1,
    "value_smoothing.radius": 0.1,
    "value_smoothing.weight": 0.5,
    "outcome.radius": 0.1,
    "ood.radius": 0.1,
}


def _setting():
    learner = config.replace(presets.load("odaf-demo"), SMALL)
    assert isinstance(learner, EnsembleSAC)
    terms: dict[str, Any] = {term.name: term for term in learner.terms}
    model = tiny.dynamics_model(terms["outcome"].dynamics, 5)
    state = tiny.state_of(learner, models=tuple(model if name == "outcome" else () for name in terms))
    return learner, terms, model, state, tiny.batch()


def _offsets(key, term, draws: int = DRAWS):
    """One set for the whole batch, as the released code draws."""
    offsets = draw_offsets(
        key, draws, tiny.ROWS, tiny.OBS_DIM, term.radius, shared=term.shared_draws, include_centre=False
    )
    assert len(np.unique(np.asarray(offsets[0]), axis=0)) == 1
    return offsets


def test_the_actors_loss_is_the_released_codes():
    with tiny.exactly():
        learner, terms, model, state, batch = _setting()
        key = jr.key(KEY)
        key_noise, key_offsets = jr.split(_key_for(terms["outcome"], key))
        noises = [
            terms["outcome"]._draw_noise(learner._context(state, batch), model, tiny.ROWS, one)
            for one in jr.split(key_noise, DRAWS)
        ]
        draws = {
            "noise": jr.normal(jr.fold_in(key, 0), (tiny.ROWS, tiny.ACT_DIM)),
            "policy": _offsets(_key_for(terms["policy_smoothing"], key), terms["policy_smoothing"]),
            "outcome": _offsets(key_offsets, terms["outcome"]),
            "outcome_noise": noises,
        }

        def expected(actor) -> float:
            predict = functools.partial(dynamics.PREDICT["cvae"], model)
            return released_code.actor_loss(actor, state, batch, predict, draws, policy_weight=0.1, outcome_weight=0.1)

        def found(actor):
            return learner.actor_loss(actor, state, batch, jr.key(KEY))[0]

        loss, gradient = jax.value_and_grad(found)(state.actor.now)
        np.testing.assert_allclose(loss, expected(state.actor.now), rtol=1e-9)
        tiny.assert_slopes(gradient, expected, state.actor.now, rtol=1e-4)


def test_the_critics_loss_is_the_released_codes():
    with tiny.exactly():
        learner, terms, _, state, batch = _setting()
        key = jr.key(KEY)
        key_here, _ = jr.split(_key_for(terms["ood"], key))
        key_offsets, key_actions = jr.split(key_here)
        draws = {
            "noise": jr.normal(jr.fold_in(key, 0), (tiny.ROWS, tiny.ACT_DIM)),
            "value": _offsets(_key_for(terms["value_smoothing"], key), terms["value_smoothing"]),
            "ood": _offsets(key_offsets, terms["ood"]),
            "ood_noise": jr.normal(key_actions, (DRAWS * tiny.ROWS, tiny.ACT_DIM)),
        }

        def expected(critics) -> float:
            return released_code.critic_loss(
                critics,
                state,
                batch,
                draws,
                value_weight=0.5,
                fall_weight=0.2,
                ood_weight=0.5,
                deviations=2.0,
                discount=0.99,
            )

        gradient, metrics = learner.critic_gradient(state, batch, jr.key(KEY))
        total = metrics["critic/loss"] + 0.5 * metrics["value_smoothing/loss"] + 0.5 * metrics["ood/loss"]
        np.testing.assert_allclose(total, expected(state.online_critics), rtol=1e-9)
        tiny.assert_slopes(gradient, expected, state.online_critics, rtol=1e-4)
