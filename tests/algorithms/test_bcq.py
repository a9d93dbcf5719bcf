"""BCQ against its formulas, in float64 NumPy."""

import dataclasses

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import constraints, networks, tiny
from odaf.algorithms.bcq import BCQ, BCQState, perturbation_loss
from odaf.components.critics import CriticEnsemble
from odaf.components.trained import Trained
from odaf.errors import ConfigError
from odaf.runs import presets

LEARNER = BCQ(
    hidden_sizes=(5, 4),
    behaviour_hidden_sizes=(4, 5),
    batch_size=tiny.ROWS,
    perturbation=0.3,
    num_actions=7,
    num_candidates=9,
    discount=0.9,
    target_rate=0.25,
    learning_rate=1e-2,
)


def _state() -> BCQState:
    """Different random networks; actions reach the bounds."""
    shape = jax.eval_shape(lambda: LEARNER.init(jr.key(0), tiny.SPEC, ()))
    empty = tiny.filled(shape, size=0.0)

    def filled(part: str, seed: int, size: float = 0.8):
        trained = getattr(shape, part)
        slow = None if trained.slow is None else tiny.filled(trained.slow, seed + 1, size)
        return Trained(tiny.filled(trained.now, seed, size), slow, getattr(empty, part).moments)

    return dataclasses.replace(
        empty,
        behaviour=filled("behaviour", 1, 1.0),
        critics=filled("critics", 3),
        perturbation=filled("perturbation", 5),
    )


def _perturbed(perturbation, observations, actions) -> np.ndarray:
    shift = np.tanh(networks.mlp(perturbation, np.concatenate([networks.numbers(observations), actions], axis=1)))
    return np.clip(actions + 0.3 * shift, -1.0, 1.0)


def _candidates(behaviour, perturbation, observations, noise) -> np.ndarray:
    """[draws, rows, act_dim]."""
    drawn = [np.tanh(constraints.decoded(behaviour, observations, one)) for one in noise]
    return np.stack([_perturbed(perturbation, observations, actions) for actions in drawn])


def _target(state, behaviour, batch, noise) -> np.ndarray:
    candidates = _candidates(behaviour, state.perturbation.slow, batch.next_observations, noise)
    return constraints.best_target(state.critics.slow, batch, candidates, 0.9)


def _perturbation_loss(perturbation, critics, observations, actions) -> float:
    moved = _perturbed(perturbation, observations, actions)
    return -float(np.mean(networks.q_values(critics, observations, moved)[0]))


def test_the_target_moves_actions_of_the_model_by_the_slow_perturbation_and_cuts_the_latent_noise():
    with tiny.exactly():
        state, batch = _state(), tiny.batch()
        with tiny.recorded() as drawn:
            y = LEARNER.target(state, state.behaviour.now, batch, jr.key(5))
        assert drawn[0].shape == (7, tiny.ROWS, 2 * tiny.ACT_DIM) and np.abs(drawn[0]).max() > 0.5
        np.testing.assert_allclose(y, _target(state, state.behaviour.now, batch, drawn[0]), rtol=1e-9)


def test_the_perturbation_climbs_the_first_critic_and_the_decoder_gets_nothing():
    with tiny.exactly():
        state, batch, critics = _state(), tiny.batch(), CriticEnsemble(_state().critics.now)
        perturbation, observations = state.perturbation.now, batch.observations
        noise = np.random.default_rng(3).normal(size=(tiny.ROWS, 2 * tiny.ACT_DIM))
        actions = np.tanh(constraints.decoded(state.behaviour.now, observations, noise))
        given = tiny.floats(actions)
        (loss, metrics), slope = jax.value_and_grad(perturbation_loss, has_aux=True)(
            perturbation, critics, observations, given, 0.3
        )
        np.testing.assert_allclose(loss, _perturbation_loss(perturbation, critics, observations, actions), rtol=1e-9)
        tiny.assert_slopes(slope, lambda p: _perturbation_loss(p, critics, observations, actions), perturbation)
        moved = _perturbed(perturbation, observations, actions)
        assert np.any(np.abs(moved) == 1.0)  # some are cut at a bound
        np.testing.assert_allclose(metrics["actor/shift"], np.mean(np.abs(moved - actions)), rtol=1e-9)

        def of_others(critics, actions):
            return perturbation_loss(perturbation, critics, observations, actions, 0.3)[0]

        assert tiny.all_zero(jax.grad(of_others, argnums=(0, 1))(critics, given))


def test_a_step_takes_the_model_first_then_critics_then_the_perturbation_and_slow_copies_follow():
    with tiny.exactly():
        state, batch = _state(), tiny.batch()
        with tiny.recorded() as drawn:
            after, metrics = LEARNER.update(state, batch, jr.key(1))
        for_model, for_target, for_actor = drawn
        assert np.abs(for_model).max() > 0.5  # and none of it is cut in training
        loss = constraints.behaviour_loss(state.behaviour.now, batch, for_model)
        np.testing.assert_allclose(metrics["behaviour/loss"], loss, rtol=1e-9)
        y = _target(state, after.behaviour.now, batch, for_target)  # of the new decoder
        np.testing.assert_allclose(metrics["target/mean"], y.mean(), rtol=1e-8)
        assert abs(y.mean() - _target(state, state.behaviour.now, batch, for_target).mean()) > 1e-6
        values = networks.q_values(CriticEnsemble(state.critics.now), batch.observations, batch.actions)
        np.testing.assert_allclose(metrics["critic/loss"], np.sum(np.mean((values - y) ** 2, axis=1)), rtol=1e-8)
        actions = np.tanh(constraints.decoded(after.behaviour.now, batch.observations, for_actor))
        new = CriticEnsemble(after.critics.now)
        loss = _perturbation_loss(state.perturbation.now, new, batch.observations, actions)
        np.testing.assert_allclose(metrics["actor/loss"], loss, rtol=1e-6)  # against the new critics
    for part in ("critics", "perturbation"):
        before, now = getattr(state, part), getattr(after, part)
        expected = jax.tree.map(lambda s, n: 0.75 * np.asarray(s) + 0.25 * np.asarray(n), before.slow, now.now)
        tiny.assert_close(now.slow, expected, atol=1e-9)
    assert after.behaviour.slow is None


def test_the_trained_policy_is_the_best_of_its_candidates_by_the_first_critic():
    with tiny.exactly():
        state, rows = _state(), tiny.batch().observations
        actor = LEARNER.actor(state)
        noise = np.broadcast_to(np.asarray(actor.noise)[:, None], (9, tiny.ROWS, 2 * tiny.ACT_DIM))
        candidates = _candidates(state.behaviour.now, state.perturbation.now, rows, noise)
        best = constraints.best_by_first(state.critics.now, rows, candidates)
        np.testing.assert_allclose(actor.mode(rows), best, rtol=1e-6)
        slope = jax.grad(lambda rows: jnp.sum(actor.mode(rows)))(rows)  # what an attack climbs
        assert np.isfinite(slope).all() and tiny.each_nonzero(slope)
        with tiny.recorded() as drawn:
            chosen, _ = actor.act((), rows, jr.key(2))
        assert drawn[0].shape == noise.shape
        fresh = _candidates(state.behaviour.now, state.perturbation.now, rows, drawn[0])
        np.testing.assert_allclose(chosen, constraints.best_by_first(state.critics.now, rows, fresh), rtol=1e-6)


def test_the_preset_is_as_published():
    learner = presets.load("bcq")
    assert learner == BCQ()
    assert (learner.perturbation, learner.num_actions, learner.num_candidates) == (0.05, 10, 100)
    assert (learner.hidden_sizes, learner.behaviour_hidden_sizes) == ((400, 300), (750, 750))
    assert (learner.learning_rate, learner.batch_size, learner.target_rate) == (1e-3, 100, 5e-3)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("discount", 1.0),
        ("target_rate", 0.0),
        ("perturbation", -0.1),
        ("lowest_weight", 1.5),
        ("num_actions", 0),
        ("num_candidates", 0),
        ("normaliser_epsilon", -1.0),
    ],
)
def test_impossible_settings_are_named(field, value):
    with pytest.raises(ConfigError, match=field):
        BCQ(**{field: value})
