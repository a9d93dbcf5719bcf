"""Numbers of a learner are traced: they change results, and never the compiled program."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import tiny
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.algorithms.config import replace
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.numbers import TRACED, is_off, joined, split
from odaf.data.sampling import device_columns
from odaf.runs import presets
from odaf.training import loop

LEARNER = EnsembleSAC(**tiny.SMALL)
# What a sweep would change, by dotted name.
NUMBERS = {
    "actor_learning_rate": 1e-3,
    "critic_learning_rate": 1e-3,
    "discount": 0.9,
    "initial_temperature": 0.5,
    "target_rate": 0.1,
    "outcome.weight": 0.7,
    "outcome.radius": 0.02,
}


def test_a_learner_comes_back_as_it_was():
    structure, numbers = split(presets.load("odaf"))
    assert isinstance(structure, EnsembleSAC) and structure.discount is TRACED
    assert numbers[".discount"].dtype == jnp.float32
    whole = joined(structure, {path: float(number) for path, number in numbers.items()})
    again, _ = split(whole)
    assert again == structure and hash(again) == hash(structure)


@pytest.mark.parametrize("name", sorted(NUMBERS))
def test_learners_that_differ_in_a_number_have_one_structure(name):
    learner = presets.load("odaf")
    assert split(learner)[0] == split(replace(learner, {name: NUMBERS[name]}))[0]


@pytest.mark.parametrize("change", [{"outcome.weight": 0.0}, {"num_critics": 4}, {"target_deviations": 0.1}])
def test_what_switches_a_part_on_or_off_is_structure(change):
    learner = presets.load("odaf")
    assert split(learner)[0] != split(replace(learner, change))[0]


def test_off_is_exactly_zero_and_never_a_traced_number():
    assert is_off(0.0) and is_off(0) and not is_off(1e-30)
    assert not is_off(jnp.zeros(()))


def _columns(dataset):
    from odaf.data.normalisation import Normaliser

    return device_columns(dataset, Normaliser.fit(dataset.observations))


def _trained(learner, dataset, updates: int = 3):
    spec, key = dataset.spec(), jr.key(0)
    models = learner.untrained(key, spec)
    state = loop.donatable(loop.first_state(learner, spec, key, models))
    return loop.train_stretch(
        learner, _columns(dataset), loop.training_key(0), loop.update_number(0), loop.update_number(updates), state
    )


def test_a_changed_number_compiles_nothing_and_changes_what_it_should():
    dataset = tiny.linear_dataset(episodes=4, length=10)
    base = presets.load("odaf", {**tiny.SMALL, "outcome.dynamics.hidden_sizes": (5, 4), "outcome.num_states": None})
    state, _ = _trained(base, dataset)
    program: Any = loop._train_stretch  # JAX counts what it has compiled
    compiled = program._cache_size()
    moved = {}
    for name, value in NUMBERS.items():
        moved[name], metrics = _trained(replace(base, {name: value}), dataset)
        assert all(np.isfinite(np.asarray(metric)) for metric in metrics.values())
    assert program._cache_size() == compiled
    for name, other in moved.items():
        leaves = zip(jax.tree.leaves(state), jax.tree.leaves(other), strict=True)
        assert any(not np.array_equal(ours, theirs) for ours, theirs in leaves), f"{name} changes nothing"


def test_traced_numbers_give_the_results_of_constants():
    learner = dataclasses.replace(LEARNER, actor_learning_rate=7e-4, discount=0.97, target_deviations=0.3)
    state, batch = tiny.state_of(learner), tiny.batch()
    structure, numbers = split(learner)
    plainly = jax.jit(learner.update)(state, batch, jr.key(1))
    traced = jax.jit(lambda numbers: joined(structure, numbers).update(state, batch, jr.key(1)))(numbers)
    tiny.assert_close(traced, plainly, rtol=1e-5, atol=1e-6)


def test_learning_rates_of_other_learners_are_traced_too():
    one, other = BehaviourCloning(hidden_sizes=(5,)), BehaviourCloning(hidden_sizes=(5,), learning_rate=1e-3)
    assert split(one)[0] == split(other)[0]
