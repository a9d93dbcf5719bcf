"""The average of the actor: by hand, however a run is cut, in lanes, and in all that asks a run for its policy."""

import dataclasses
from typing import Any

import jax
import numpy as np
import pytest

import odaf
from golden.tiny import assert_close, assert_same_bits
from odaf.errors import ConfigError
from odaf.training import loop
from odaf.training.averaging import AveragedState, deployed_actor, learner_state

QUIET: dict[str, Any] = {"stretch": 2, "progress": False, "keep_checkpoints": "all"}
HORIZON = 3


@pytest.fixture
def learner(tiny):
    return tiny.TinyLearner(averaged_updates=HORIZON)


@pytest.fixture
def run(tiny, learner, tmp_path):
    """Six updates with a checkpoint after each, cut in the middle."""
    directory = tmp_path / "averaged"
    odaf.fit(learner, tiny.tiny_dataset(), steps=4, directory=directory, checkpoint_every=1, **QUIET)
    return odaf.resume(directory, steps=6, dataset=tiny.tiny_dataset(), progress=False)


def test_a_plain_mean_at_first_then_weights_that_fall(run):
    states = [run.files.state(0, step) for step in range(1, 7)]
    actors = [np.asarray(learner_state(state).weights) for state in states]
    expected = actors[0]
    for number, (state, actor) in enumerate(zip(states, actors, strict=True), 1):
        expected = expected + max(1 / number, 1 / HORIZON) * (actor - expected)
        np.testing.assert_allclose(state.average.weights, expected, rtol=1e-5, atol=1e-6)
        if number <= HORIZON:
            np.testing.assert_allclose(state.average.weights, np.mean(actors[:number], axis=0), rtol=1e-5, atol=1e-6)
        assert int(state.step) == number == int(state.learner.step)


def test_the_learner_does_not_see_it(tiny, run, tmp_path):
    plain = odaf.fit(
        tiny.TinyLearner(), tiny.tiny_dataset(), steps=6, directory=tmp_path / "other", checkpoint_every=2, **QUIET
    )
    assert_same_bits(plain.files.state(0), learner_state(run.files.state(0)))


def test_it_is_the_policy(run):
    state, policy = run.files.state(0), run.policy(0)
    assert isinstance(state, AveragedState)
    assert_same_bits(policy.actor, state.average)
    assert np.abs(np.asarray(policy.actor.weights) - np.asarray(state.learner.weights)).max() > 1e-3  # type: ignore


def test_a_cut_changes_no_bit(tiny, learner, run, tmp_path):
    whole = odaf.fit(learner, tiny.tiny_dataset(), steps=6, directory=tmp_path / "other", checkpoint_every=6, **QUIET)
    assert_same_bits(whole.files.state(0), run.files.state(0))


def test_lanes_have_an_average_each(tiny, learner, run, tmp_path):
    seeds = odaf.fit(
        learner, tiny.tiny_dataset(), steps=6, seeds=(0, 1), directory=tmp_path / "other", lanes=2, **QUIET
    )
    assert_close(seeds.files.state(0), run.files.state(0), rtol=1e-5, atol=1e-6)
    averages = [seeds.files.state(seed).average.weights for seed in (0, 1)]
    assert np.abs(np.asarray(averages[0]) - np.asarray(averages[1])).max() > 1e-3


def test_a_refresh_reaches_the_learner_and_leaves_the_average(tiny):
    class Refreshed(tiny.TinyLearner):
        refresh_every = 1

        def refresh(self, state, columns, key):
            return dataclasses.replace(state, slow=state.slow + 1.0)

    learner, dataset = Refreshed(averaged_updates=HORIZON), tiny.tiny_dataset()
    columns = odaf.data.training_columns(dataset, learner.normaliser(dataset), learner.drawn_view())
    models = learner.untrained(jax.random.key(0), dataset.spec())
    state = loop.donatable(loop.first_state(learner, dataset.spec(), loop.init_key(0), models))
    number, before = loop.update_number, np.asarray(learner_state(state).slow)
    after, _ = loop.train_stretch(learner, columns, loop.training_key(0), number(0), number(1), state)
    np.testing.assert_allclose(
        after.learner.slow, 0.9 * (before + 1.0) + 0.1 * np.asarray(after.learner.weights), rtol=1e-5
    )
    np.testing.assert_allclose(after.average.weights, after.learner.weights, rtol=1e-5)


def test_without_a_horizon_nothing_is_kept(tiny):
    learner, dataset = tiny.TinyLearner(), tiny.tiny_dataset()
    models = learner.untrained(jax.random.key(0), dataset.spec())
    state = loop.first_state(learner, dataset.spec(), loop.init_key(0), models)
    assert isinstance(state, tiny.TinyState) and learner_state(state) is state
    assert_same_bits(deployed_actor(learner, state), learner.actor(state))


def test_a_horizon_below_zero_is_refused(tiny, tmp_path):
    with pytest.raises(ConfigError, match="averaged_updates=-1: must be a number of updates, or 0"):
        odaf.fit(
            tiny.TinyLearner(averaged_updates=-1), tiny.tiny_dataset(), steps=2, directory=tmp_path / "other", **QUIET
        )
    assert not (tmp_path / "other").exists()
