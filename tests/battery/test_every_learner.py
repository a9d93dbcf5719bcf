"""What every registered learner keeps, in full: who adds one inherits these tests by registering it."""

import dataclasses
import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

import odaf
from battery import learners
from golden import tiny
from odaf.algorithms import config
from odaf.algorithms.numbers import joined, split
from odaf.algorithms.registry import ALGORITHMS, TERMS
from odaf.cli.options import field_help, settings_of
from odaf.data.normalisation import Normaliser
from odaf.data.sampling import WeightedColumns, training_column_shapes, training_columns
from odaf.deployment import odaf_policy
from odaf.errors import ConfigError
from odaf.training import loop
from odaf.training.averaging import learner_state
from odaf.training.monitors import DivergenceMonitor
from odaf.training.run_directory import blank_state

each_learner = pytest.mark.parametrize("kind", learners.KINDS)
SEEDS = (3, 5)


@functools.cache
def _log():
    return learners.log()


def _columns(learner):
    dataset = _log()
    return training_columns(dataset, learner.normaliser(dataset), learner.drawn_view())


def _models(learner, seed: int):
    dataset = _log()
    normaliser = learner.normaliser(dataset)
    return learner.pretrain(dataset, normaliser, loop.pretrain_key(seed), lambda *_: None)


def _first(learner, seed: int):
    models, _ = _models(learner, seed)
    return loop.donatable(loop.first_state(learner, _log().spec(), loop.init_key(seed), models))


def _train(learner, seed: int, state, first: int, last: int):
    number = loop.update_number
    return loop.train_stretch(learner, _columns(learner), loop.training_key(seed), number(first), number(last), state)


@functools.cache
def _trained(kind: str, seed: int = 3) -> tuple[Any, dict[str, Any]]:
    """State and metrics of a few updates."""
    learner = learners.of_kind(kind)
    return _train(learner, seed, _first(learner, seed), 0, 4)


def _played(policy, observations):
    """First actions of an episode that begins at each observation."""
    return policy.act(policy.begin(len(observations)), observations)[0]


@each_learner
def test_updates_keep_the_shape_of_the_state_and_stay_finite(kind):
    learner, dataset = learners.of_kind(kind), _log()
    state, metrics = _trained(kind)
    blank = blank_state(learner, dataset.spec())
    assert jax.tree.structure(eqx.filter(state, eqx.is_array)) == jax.tree.structure(
        eqx.filter(blank, lambda leaf: isinstance(leaf, jax.ShapeDtypeStruct))
    )
    pairs = zip(jax.tree.leaves(state), jax.tree.leaves(blank), strict=True)
    assert all((ours.shape, ours.dtype) == (theirs.shape, theirs.dtype) for ours, theirs in pairs)
    assert int(state.step) == 4 and loop.is_finite(state)
    assert metrics and all(np.isfinite(float(value)) for value in metrics.values())
    assert all("/" in name for name in metrics), "metrics are named room/quantity"


@each_learner
def test_pretraining_returns_what_untrained_promises_and_reports_plain_data(kind):
    learner = learners.of_kind(kind)
    models, report = _models(learner, 1)
    blank = jax.eval_shape(lambda: learner.untrained(jr.key(0), _log().spec()))
    assert jax.tree.structure(models) == jax.tree.structure(blank)
    assert isinstance(report.pop("warnings"), list)
    assert config.from_dict(config.to_dict(learner)) == learner


@pytest.mark.parametrize("name", [*learners.KINDS, "odaf-locomotion", "sdc"])
def test_lanes_that_agree_in_what_decides_pretraining_may_share_its_models(name):
    learner: Any = learners.of_kind(name) if name in learners.KINDS else learners.of_preset(name)
    structure, numbers = split(learner)
    given = {path: float(number) for path, number in numbers.items()}
    learner = joined(structure, given)
    others = {path: joined(structure, {**given, path: 0.9 * number}) for path, number in given.items()}
    free = [path for path, other in others.items() if other.pretraining() == learner.pretraining()]
    if not jax.tree.leaves(eqx.filter_eval_shape(learner.untrained, jr.key(0), _log().spec())) or not free:
        return
    other = joined(structure, {**given, **{path: 0.9 * given[path] for path in free}})
    tiny.assert_same_bits(_models(learner, 1)[0], _models(other, 1)[0])


@each_learner
def test_actions_stay_in_bounds_and_repeat_and_draws_differ_by_key(kind):
    learner, rows = learners.of_kind(kind), 50.0 * jr.normal(jr.key(0), (7, 3))
    actor = learner.actor(_trained(kind)[0])
    carry = actor.begin(7)
    actions, after = actor.act(carry, rows)
    again, _ = actor.act(actor.begin(7), rows)
    drawn, _ = actor.act(carry, rows, jr.key(1))
    assert actions.shape == (7, 2) == drawn.shape
    assert bool(jnp.all(jnp.abs(actions) <= 1.0)) and bool(jnp.all(jnp.abs(drawn) <= 1.0))
    np.testing.assert_array_equal(actions, again)
    actor.observe(after, jnp.zeros(7))
    values = learner.values(_trained(kind)[0])
    if values is not None:
        assert bool(jnp.all(jnp.isfinite(values(rows, actions))))


@each_learner
def test_lanes_are_their_trainings_alone(kind):
    """Two lanes that differ in seed, in every number of the settings, and in the data set they draw from."""
    learner = learners.of_kind(kind)
    structure, numbers = split(learner)
    lanes = [learner, joined(structure, {name: 0.9 * float(number) for name, number in numbers.items()})]
    own = _columns(learner)
    reversed_rows = jax.tree.map(lambda column: column[::-1], own)
    together = jax.tree.map(lambda *parts: jnp.concatenate(parts), own, reversed_rows)
    rows, number = len(jax.tree.leaves(own)[0]), loop.update_number
    slabs = (jnp.asarray([0, rows], jnp.int32), jnp.asarray([rows, rows], jnp.int32))
    keys = jnp.stack([loop.training_key(seed) for seed in SEEDS])
    states = loop.stacked([_first(lane, seed) for lane, seed in zip(lanes, SEEDS, strict=True)])
    states, metrics = loop.train_lanes(*loop.split_lanes(lanes), together, slabs, keys, number(0), number(4), states)
    for place, columns in enumerate((own, reversed_rows)):
        first = loop.donatable(_first(lanes[place], SEEDS[place]))
        state, alone = loop.train_stretch(
            lanes[place], columns, loop.training_key(SEEDS[place]), number(0), number(4), first
        )
        tiny.assert_close(loop.lane(states, place), state, rtol=2e-4, atol=2e-5)
        for name, value in alone.items():
            np.testing.assert_allclose(metrics[name][place], value, rtol=1e-3, atol=1e-4, err_msg=name)


@each_learner
def test_a_run_resumes_to_the_bit_and_its_policy_is_saved_and_loaded(kind, tmp_path):
    learner, dataset = learners.of_kind(kind), _log()
    settings: dict[str, Any] = {"checkpoint_every": 2, "stretch": 2, "progress": False}
    whole = odaf.fit(learner, dataset, steps=4, directory=tmp_path / "whole", **settings)
    odaf.fit(learner, dataset, steps=2, directory=tmp_path / "cut", **settings)
    cut = odaf.resume(tmp_path / "cut", steps=4, dataset=dataset, progress=False)
    tiny.assert_same_bits(whole.files.state(0), cut.files.state(0))
    policy = whole.policy(0)
    policy.save(tmp_path / "policy.safetensors")
    loaded = type(policy).load(tmp_path / "policy.safetensors")
    seen = dataset.observations[:5]
    actions = _played(policy, seen)
    np.testing.assert_array_equal(_played(loaded, seen), actions)
    assert np.all(actions >= dataset.action_low) and np.all(actions <= dataset.action_high)


@each_learner
def test_a_policy_is_exported_and_its_form_for_numpy_alone_acts_as_it_does(kind, tmp_path):
    learner, dataset = learners.of_kind(kind), _log()
    low, high = (tuple(end.tolist()) for end in (dataset.action_low, dataset.action_high))
    normaliser = learner.normaliser(dataset)
    policy = odaf.Policy(learner.actor(_trained(kind)[0]), normaliser, low, high, dataset.observation_names)
    artefact = odaf.export(policy, tmp_path / "out", forms=["numpy"])  # compares them on inputs of all kinds
    checked = artefact.contract["checked"]["policy.safetensors"]
    assert checked["steps"] == 320 or (policy.has_memory and checked["steps"] > 250)
    assert checked["largest_difference"] < 1e-5 and checked["left_to_rounding"] < 32
    carried = odaf_policy.Policy(tmp_path / "out" / "policy.safetensors")
    rows = dataset.observations[:3]
    for row, action in zip(rows, _played(policy, rows), strict=True):
        carried.begin()
        found = carried.act([*row, *[0.0] * (len(carried.columns) - len(row))])  # nothing was earned before
        assert found is not None and np.abs(found - action).max() < 3e-5, "half a range is 3"


@each_learner
def test_rows_drawn_by_return_train_the_same_bits_however_it_is_cut(kind):
    """Where critics can draw apart, they do: until the actor has stepped they are those of a run on all rows alike."""
    plain = learners.of_kind(kind)
    apart = "uniform" if plain.draws_apart else "same"
    learner = dataclasses.replace(
        plain, sampling="return", return_temperature=0.5, critic_sampling=apart, averaged_updates=2
    )
    assert isinstance(_columns(learner), WeightedColumns)
    whole, _ = _train(learner, 3, _first(learner, 3), 0, 4)
    cut, _ = _train(learner, 3, loop.donatable(_train(learner, 3, _first(learner, 3), 0, 2)[0]), 2, 4)
    tiny.assert_same_bits(whole, cut)
    assert jax.tree.structure(whole.average) == jax.tree.structure(learner.actor(whole.learner))
    if not plain.draws_apart:
        with pytest.raises(ConfigError, match=f"critic_sampling='uniform': {kind} learns all it learns from one batch"):
            dataclasses.replace(learner, critic_sampling="uniform").drawn_view()
        return
    first = [learner_state(_train(each, 3, _first(each, 3), 0, 1)[0]) for each in (learner, plain)]
    for ours, theirs in zip(*(jax.tree.leaves(learner.values(state)) for state in first), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-7)
    actors = [jax.tree.leaves(learner.actor(state)) for state in (whole.learner, _trained(kind)[0])]
    assert any(float(jnp.abs(ours - theirs).max()) > 1e-5 for ours, theirs in zip(*actors, strict=True))


@each_learner
def test_what_is_learned_from_does_not_depend_on_the_order_of_the_episodes(kind):
    learner, dataset = learners.of_kind(kind), _log()
    turned = dataset.select(range(dataset.num_episodes)[::-1])
    normaliser = Normaliser.fit(dataset.observations)

    def rows(data):
        columns = training_columns(data, normaliser, learner.view())
        flat = [np.asarray(leaf).reshape(len(leaf), -1) for leaf in jax.tree.leaves(columns)]
        table = np.concatenate(flat, axis=1)
        return table[np.lexsort(table.T)]

    np.testing.assert_array_equal(rows(dataset), rows(turned))
    shapes = jax.tree.map(lambda leaf: leaf.shape, training_column_shapes(dataset, learner.view()))
    assert shapes == jax.tree.map(lambda leaf: leaf.shape, training_columns(dataset, normaliser, learner.view()))


@each_learner
def test_every_number_can_change_without_another_program(kind):
    learner = learners.of_kind(kind)
    structure, numbers = split(learner)
    assert numbers, "a learner has at least a learning rate"
    for field in dataclasses.fields(learner):  # type: ignore[arg-type]
        value = getattr(learner, field.name)
        if isinstance(value, float) and value != 0.0 and field.name not in learner.structural:
            changed = dataclasses.replace(learner, **{field.name: 0.5 * value})  # type: ignore[type-var]
            assert split(changed)[0] == structure, field.name


@each_learner
def test_advice_names_only_options_that_the_learner_has(kind):
    learner = learners.of_kind(kind)
    settings = config.to_dict(learner)
    monitor = DivergenceMonitor(_log().spec(), learner.view().discount, settings)
    bad = {"critic/max": 1e9, "critic/min": -1e9, "temperature/value": 1e9}
    found = [*monitor.observe(1, bad), *monitor.observe(2, {"actor/loss": float("nan")})]
    for warning in found:
        for word in warning.message.replace(";", " ").split():
            name, equals, _ = word.partition("=")
            assert not equals or name in settings, warning.message


@each_learner
def test_a_learner_names_its_paper(kind):
    assert ALGORITHMS[kind]().citations(), f"give {kind} a method `citations`; algorithms/citations.py has papers"


@pytest.mark.parametrize("name", [name for name in TERMS if TERMS[name].__module__.startswith("odaf.")])
def test_a_term_names_its_paper(name):
    assert TERMS[name]().citations(), f"give {name} a method `citations`; algorithms/citations.py has papers"


@each_learner
def test_every_setting_is_an_option_with_a_line_of_help(kind):
    help_lines = field_help(ALGORITHMS[kind])
    options = [name for name, *_ in settings_of(ALGORITHMS[kind]())]
    assert all(help_lines.get(name) for name in options), [name for name in options if not help_lines.get(name)]
