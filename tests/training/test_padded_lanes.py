"""Data sets of other widths in one program: what a padded lane computes and leaves behind is what it does alone."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

import odaf
from battery import learners
from odaf.algorithms.terms import BehaviourDistance, GradientDiversity, OutcomePenalty
from odaf.components.perturbations import draw_offsets
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.padding import Padding
from odaf.data.sampling import padded_columns, training_columns
from odaf.data.transitions import Transitions
from odaf.errors import ConfigError
from odaf.runs.many import Plan, fit_many
from odaf.training import loop
from odaf.training.run_directory import RunDirectory
from odaf.training.widths import PaddedState

WIDE = (3, 2)  # observations and actions of `learners.log`
SHOWN: dict[str, Any] = {"stretch": 2, "checkpoint_every": 2, "seeds": (0, 5)}
SETTINGS: dict[str, Any] = {"progress": False, **SHOWN}


def _narrow(log: Dataset) -> Dataset:
    """A robot with two observations and one action."""
    return Dataset.from_arrays(
        log.observations[:, :2],
        log.actions[:, :1],
        log.rewards,
        next_observations=log.next_observations[:, :2],
        terminated=log.terminated,
        truncated=log.truncated,
        action_bounds=(-2.0, 4.0),
    )


LOGS = (learners.log(), _narrow(learners.log(seed=1)))
LEARNERS: dict[str, Any] = {
    "behaviour-cloning": learners.of_kind("behaviour-cloning"),
    "behaviour-cloning, gaussian": dataclasses.replace(learners.of_kind("behaviour-cloning"), actor_kind="gaussian"),
    "td3-bc": learners.of_kind("td3-bc"),
    "rebrac": learners.of_kind("rebrac"),
    "iql": dataclasses.replace(learners.of_kind("iql"), actor_kind="gaussian"),
    "iql, deterministic": dataclasses.replace(learners.of_kind("iql"), actor_kind="deterministic"),
    "sac-n": dataclasses.replace(learners.of_preset("sac-n"), entropy_in_backup=True),
    "terms": dataclasses.replace(
        learners.of_preset("edac"), terms=(GradientDiversity(), BehaviourDistance(target_weight=0.1))
    ),
    "odaf": learners.of_preset("odaf-light"),
    "odaf, sampled": learners.small(
        dataclasses.replace(
            learners.of_preset("sac-n"), terms=(OutcomePenalty(solver="sample", num_draws=3, target_weight=0.5),)
        )
    ),
}


def _columns(learner, log):
    return training_columns(log, Normaliser.fit(log.observations, 0.0), learner.drawn_view())


@pytest.mark.parametrize("name", LEARNERS)
def test_a_padded_lane_computes_what_it_computes_alone(name):
    learner = LEARNERS[name]
    assert learner.can_be_padded()
    key, number = loop.training_key(3), loop.update_number
    firsts, padders = [], [PaddedState(learner, log.spec(), WIDE) for log in LOGS]
    for log in LOGS:
        models, _ = learner.pretrain(log, Normaliser.fit(log.observations, 0.0), jr.key(1), lambda *_: None)
        firsts.append(loop.donatable(loop.first_state(learner, log.spec(), loop.init_key(0), models)))
    wide = [padded_columns(_columns(learner, log), WIDE) for log in LOGS]
    together = jax.tree.map(lambda *parts: jnp.concatenate(parts), *wide)
    rows = [jax.tree.leaves(each)[0].shape[0] for each in wide]
    slabs = (jnp.asarray([0, rows[0]], jnp.int32), jnp.asarray(rows, jnp.int32))
    states = loop.stacked([padder.pad(first) for padder, first in zip(padders, firsts, strict=True)])
    padding = loop.padding_of([(log.obs_dim, log.act_dim) for log in LOGS], ((2, 1), (3, 2)))
    structure, numbers = loop.split_lanes([learner, learner])
    keys = jnp.stack([key, key])
    states, metrics = loop.train_lanes(structure, numbers, together, slabs, keys, number(0), number(4), states, padding)
    for place, (log, padder) in enumerate(zip(LOGS, padders, strict=True)):
        alone, values = loop.train_stretch(
            learner, _columns(learner, log), key, number(0), number(4), loop.donatable(firsts[place])
        )
        own = padder.lane(states, place)
        for one, other in zip(jax.tree.leaves(own), jax.tree.leaves(alone), strict=True):
            np.testing.assert_allclose(one, other, rtol=2e-4, atol=2e-5)
        for metric, value in values.items():
            np.testing.assert_allclose(metrics[metric][place], value, rtol=1e-3, atol=1e-4, err_msg=metric)
        # What was padded is zero to the bit, moments and slow copies included.
        for one, other in zip(jax.tree.leaves(padder.pad(own)), jax.tree.leaves(loop.lane(states, place)), strict=True):
            np.testing.assert_array_equal(one, other)


def test_noise_of_a_padded_lane_has_the_bits_of_its_own_width():
    for own in (1, 3):
        padding = Padding(jnp.asarray(2 * own), jnp.asarray(own), ((2, 1), (6, 3)))
        drawn = padding.normal(jr.key(7), 5, 4)
        np.testing.assert_array_equal(drawn[:, :own], jr.normal(jr.key(7), (5, own)))
        assert not drawn[:, own:].any()
        settings: dict[str, Any] = {"shared": False, "include_centre": False}
        offsets = draw_offsets(jr.key(8), 3, 5, 7, 0.1, padding=padding, **settings)
        np.testing.assert_array_equal(offsets[..., : 2 * own], draw_offsets(jr.key(8), 3, 5, 2 * own, 0.1, **settings))
        assert not offsets[..., 2 * own :].any()


def test_a_batch_counts_its_own_dimensions():
    values = jnp.arange(6.0).reshape(2, 3)
    rows, number = jnp.zeros((2, 3)), jnp.zeros(2)
    batch = Transitions(rows, rows, number, rows, number, padding=Padding(jnp.asarray(3), jnp.asarray(2), ((3, 2),)))
    assert float(batch.mean_over_actions(values)) == (0.0 + 1.0 + 3.0 + 4.0) / 4.0
    assert batch.own_actions is not None and batch.own_actions.tolist() == [True, True, False]


def test_a_run_among_wider_ones_leaves_what_it_leaves_alone_and_goes_on_to_the_same_bits(tmp_path, capsys):
    learner = LEARNERS["behaviour-cloning"]

    def train(folder, steps):
        plans = [
            Plan(learner, log, tmp_path / folder / name) for log, name in zip(LOGS, ("wide", "narrow"), strict=True)
        ]
        return fit_many(plans, steps=steps, lanes=4, **SHOWN)

    whole = train("whole", 4)
    assert "observations and actions padded to 3 and 2" in capsys.readouterr().err
    assert [run.files.config["widths"] for run in whole] == [[3, 2]] * 2
    alone = odaf.fit(learner, LOGS[1], directory=tmp_path / "alone", steps=4, **SETTINGS)
    for one, other in zip(jax.tree.leaves(whole[1].files.state(5)), jax.tree.leaves(alone.files.state(5)), strict=True):
        np.testing.assert_allclose(one, other, rtol=2e-4, atol=2e-5)
    seen = LOGS[1].observations[:4]
    np.testing.assert_allclose(whole[1].policy(5)(seen), alone.policy(5)(seen), rtol=2e-4, atol=2e-4)

    train("cut", 2)
    narrow = tmp_path / "cut" / "narrow"
    odaf.resume(narrow, 4, dataset=LOGS[1], progress=False)
    state, other = RunDirectory(narrow).state(5), whole[1].files.state(5)
    for one, two in zip(jax.tree.leaves(state), jax.tree.leaves(other), strict=True):
        np.testing.assert_array_equal(one, two)


def test_learners_without_a_padded_form_train_apart_and_the_plan_says_so(tiny, tmp_path, capsys):
    plans = [Plan(tiny.TinyLearner(), log, tmp_path / str(log.obs_dim)) for log in LOGS]
    done = fit_many(plans, steps=2, lanes=4, progress=True, **SHOWN)
    told = capsys.readouterr().err
    assert "program 2 of 2" in told and "tiny has no padded form" in told
    assert [run.files.config["widths"] for run in done] == [None, None]
    with pytest.raises(ConfigError, match="widths: tiny has no padded form"):
        fit_many([Plan(tiny.TinyLearner(), LOGS[0], tmp_path / "asked")], steps=2, lanes=2, widths=(9, 9), **SETTINGS)


def test_widths_that_cannot_be_are_refused(tmp_path):
    learner = LEARNERS["behaviour-cloning"]
    with pytest.raises(ConfigError, match="widths: lanes are padded, and this run has none"):
        odaf.fit(learner, LOGS[0], directory=tmp_path / "one", steps=2, lanes=1, widths=(9, 9), **SETTINGS)
    with pytest.raises(ConfigError, match=r"widths: \(2, 2\) asked, but the data of .* have 3 observations"):
        odaf.fit(learner, LOGS[0], directory=tmp_path / "narrow", steps=2, lanes=2, widths=(2, 2), **SETTINGS)
