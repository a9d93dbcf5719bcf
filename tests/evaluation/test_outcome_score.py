"""The pieces of the validation: similar states, the inverse map, areas under the curve, states after a knock."""

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest
from jaxtyping import Array

from golden import tiny
from golden.runs import dataset_of
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import DatasetError
from odaf.evaluation.inverse_map import fit_inverse_map
from odaf.evaluation.knocked_states import Axes, knocked_states
from odaf.evaluation.outcome_score import area_under_curve
from odaf.evaluation.recovery import KnownGround
from odaf.evaluation.similar_pairs import similar_pairs

ENVIRONMENT = {"name": "gymnasium", "id": "Hopper-v5"}


def steered(episodes: int = 30, steps: int = 20) -> Dataset:
    """States that move by a tenth of the action."""
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 1, (episodes, steps, 2)).astype(np.float32)
    states = np.cumsum(np.concatenate([rng.normal(size=(episodes, 1, 2)), 0.1 * actions], axis=1), axis=1)
    return Dataset.from_arrays(
        states[:, :-1].reshape(-1, 2),
        actions.reshape(-1, 2),
        np.zeros(episodes * steps),
        states[:, 1:].reshape(-1, 2),
        truncated=np.tile(np.arange(steps) == steps - 1, episodes),
        action_bounds=(-1.0, 1.0),
    )


def test_similar_states_are_the_nearest_of_other_episodes():
    dataset = steered()
    normaliser = Normaliser.fit(dataset.observations)
    pairs = similar_pairs(dataset, normaliser, count=50, seed=1)
    episode = np.repeat(np.arange(30), 20)
    assert 0 < len(pairs.rows) <= 50 and (episode[pairs.rows] != episode[pairs.others]).all()
    states = normaliser.normalise(dataset.observations)
    for row, other, distance in zip(pairs.rows, pairs.others, pairs.distances, strict=True):
        apart = np.linalg.norm(states - states[row], axis=1)
        apart[episode == episode[row]] = np.inf
        assert distance == pytest.approx(apart[other], abs=1e-5) and distance < pairs.threshold
        assert apart.min() == pytest.approx(distance, abs=1e-5)


def test_one_episode_has_no_similar_states():
    dataset = steered(1)
    with pytest.raises(DatasetError, match="the log has 1 episode; two or more are needed"):
        similar_pairs(dataset, Normaliser.fit(dataset.observations))


def test_an_inverse_map_finds_the_action_that_leads_there():
    dataset = steered()
    normaliser = Normaliser.fit(dataset.observations)
    model, fit = fit_inverse_map(dataset, normaliser, jr.key(0), 400, (16,), lambda done, steps: None)
    assert 0.9 < fit <= 1.0
    states = [
        jnp.asarray(normaliser.normalise(each[:50])) for each in (dataset.observations, dataset.next_observations)
    ]
    assert np.abs(np.asarray(model(*states)) - dataset.actions[:50]).mean() < 0.15


def test_the_area_under_the_curve_counts_pairs():
    # Of six pairs the unsafe one is higher in four; one is a tie.
    assert area_under_curve(np.array([1.0, 2.0, 3.0]), np.array([2.0, 4.0])) == pytest.approx((1 + 0.5 + 0 + 3) / 6)
    assert area_under_curve(np.zeros(3), np.zeros(4)) == 0.5


def test_the_axes_are_those_in_which_states_differ_most():
    rng = np.random.default_rng(0)
    states = rng.normal(size=(4_000, 3)) * [1.0, 5.0, 0.1] + [1.0, 2.0, 3.0]
    axes = Axes.of(states)
    assert np.abs(axes.directions).round(1).tolist() == [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]
    assert axes.directions[0, 1] > 0 and axes.share[0] == pytest.approx(25 / 26, abs=0.01)
    assert axes.place(states).std(axis=0) == pytest.approx([5.0, 1.0], rel=0.05)


def test_states_after_a_knock_are_told_by_their_distance_to_the_log():
    dataset = dataset_of(3, 1, ENVIRONMENT, episodes=40)
    normaliser = Normaliser.fit(dataset.observations)
    ground = KnownGround.of(dataset, normaliser)
    inside, outside = dataset.observations[0], np.full(3, 50.0, np.float32)
    gone = np.full(3, np.nan, np.float32)
    seen = np.stack([np.stack([outside, outside, inside]), np.stack([outside, gone, gone])])
    found = knocked_states(dataset, normaliser, ground, seen)
    assert found is not None and found.episodes == 2 and found.points.shape == (4, 2)
    # Two steps outside of three, and all three of an episode that ends there: a fall is no return.
    assert found.beyond == pytest.approx(5 / 6) and found.recovery.tolist() == [2.0, np.inf]
    assert knocked_states(dataset, normaliser, ground, seen[:0]) is None


def uncertainty_by_hand(critics, actor, states: np.ndarray, noise: np.ndarray) -> np.ndarray:
    spreads = []
    for each in noise:
        mean, log_std = (np.asarray(part) for part in actor.parameters(jnp.asarray(states)))
        actions = np.tanh(mean + np.exp(log_std) * each)
        values = np.asarray(critics(jnp.asarray(states), jnp.asarray(actions)))
        spreads.append(values.std(axis=0))
    return np.mean(spreads, axis=0)


def test_the_score_of_an_outcome_is_the_mean_spread_of_the_critics_over_actions_of_the_policy():
    from odaf.algorithms.ensemble_sac import EnsembleSAC
    from odaf.evaluation.outcome_score import action_uncertainty, outcome_uncertainty

    learner = EnsembleSAC(num_critics=3, hidden_sizes=(4,))
    state = tiny.state_of(learner)
    critics, actor = learner.values(state), learner.actor(state)
    states = np.asarray(tiny.batch(6).observations)
    noise: Array = jr.normal(jr.key(3), (5, 6, tiny.ACT_DIM))
    found = outcome_uncertainty(critics, actor, states, jr.key(3), actions=5)
    assert found == pytest.approx(uncertainty_by_hand(critics, actor, states, np.asarray(noise)), rel=1e-4)
    actions = np.zeros((6, tiny.ACT_DIM), np.float32)
    by_hand = np.asarray(critics(jnp.asarray(states), jnp.asarray(actions))).std(axis=0)
    assert action_uncertainty(critics, states, actions) == pytest.approx(by_hand, rel=1e-4)
