"""One compiled call for many seeds, and for many devices, against the plain stretch of one seed on one device."""

import os
import subprocess
import sys
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import odaf
from odaf.algorithms.td3_bc import TD3BC
from odaf.data.normalisation import Normaliser
from odaf.data.sampling import device_columns
from odaf.training import loop
from odaf.training.run_directory import blank_state

SEEDS = (3, 5, 8)


def _first(learner, dataset, seed):
    normaliser = Normaliser.fit(dataset.observations)
    side, _ = learner.pretrain(dataset, normaliser, loop.pretrain_key(seed), lambda *_: None)
    return loop.donatable(loop.first_state(learner, dataset.spec(), loop.init_key(seed), side))


def _fixed(learner, dataset, key, first, last):
    columns = device_columns(dataset, Normaliser.fit(dataset.observations))
    return (learner, columns, key, jnp.asarray(first), jnp.asarray(last))


def _close(ours, theirs):
    ours, theirs = (jax.tree.leaves(eqx.filter(tree, eqx.is_array)) for tree in (ours, theirs))
    for one, other in zip(ours, theirs, strict=True):
        assert one.dtype == other.dtype
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("kind", ["tiny", "ensemble"])
def test_each_lane_is_its_seed_alone(tiny, kind):
    learner, dataset = tiny.TinyLearner(), tiny.tiny_dataset()
    if kind == "ensemble":
        learner = odaf.EnsembleSAC(num_critics=2, hidden_sizes=(8,), batch_size=8)
    keys = jnp.stack([loop.training_key(seed) for seed in SEEDS])
    states = loop.stacked([_first(learner, dataset, seed) for seed in SEEDS])
    for first, last in ((0, 2), (2, 5)):
        structure, numbers = loop.split_lanes([learner] * len(SEEDS))
        _, columns, _, begin, end = _fixed(learner, dataset, keys, first, last)
        states, many = loop.train_lanes(structure, numbers, columns, None, keys, begin, end, states)
    for index, seed in enumerate(SEEDS):
        state = _first(learner, dataset, seed)
        for first, last in ((0, 2), (2, 5)):
            fixed = _fixed(learner, dataset, loop.training_key(seed), first, last)
            state, metrics = loop.train_stretch(*fixed, state)
        _close(loop.lane(states, index), state)
        _close({name: values[index] for name, values in many.items()}, metrics)


def test_what_is_done_every_few_updates_is_branched_to_in_lanes(tiny):
    """Not computed in every update and thrown away, as it would be if each lane counted its updates for itself."""
    dataset, number = tiny.tiny_dataset(), loop.update_number
    learner = TD3BC(hidden_sizes=(4,), batch_size=4, actor_delay=3, averaged_updates=5)
    structure, numbers = loop.split_lanes([learner] * 2)
    columns = device_columns(dataset, Normaliser.fit(dataset.observations))
    keys = jnp.stack([loop.training_key(seed) for seed in (3, 5)])
    blank = blank_state(learner, dataset.spec())
    states = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct((2, *leaf.shape), leaf.dtype), blank)
    lowered = loop._train_lanes.lower(structure, numbers, columns, None, keys, number(0), number(3), states, None)
    assert lowered.as_text().count("stablehlo.case") == 1


SHARDED = """
import sys
from pathlib import Path
sys.path.insert(0, str(Path(sys.argv[1])))
import jax, jax.numpy as jnp, numpy as np
import tiny_learner as tiny
import odaf
from odaf.data.normalisation import Normaliser
from odaf.data.sampling import device_columns
from odaf.training import loop
from odaf.algorithms.numbers import split

assert jax.device_count() == 4
dataset = tiny.tiny_dataset()
columns = device_columns(dataset, Normaliser.fit(dataset.observations))
for learner in (tiny.TinyLearner(), odaf.EnsembleSAC(num_critics=2, hidden_sizes=(8,), batch_size=8)):
    found = []
    for devices in (1, 4):
        side, _ = learner.pretrain(dataset, Normaliser.fit(dataset.observations), jax.random.key(1), lambda *_: None)
        state = loop.donatable(loop.first_state(learner, dataset.spec(), loop.init_key(0), side))
        mesh, here = None, columns
        if devices > 1:
            mesh = loop.batch_mesh(devices, learner.batch_size)
            state, here = loop.on_every_device((state, columns), mesh)
        lines = []
        for first in (0, 2, 4):
            fixed = (learner, here, loop.training_key(0), jnp.asarray(first), jnp.asarray(first + 2))
            state, metrics = loop.train_stretch(*fixed, state, mesh)
            lines.append({name: float(value) for name, value in metrics.items()})
        leaves = [leaf for leaf in jax.tree.leaves(state) if isinstance(leaf, jax.Array)]
        assert all(len(leaf.devices()) == devices and leaf.is_fully_replicated for leaf in leaves)
        found.append((lines, leaves))
    (lines, leaves), (sharded_lines, sharded) = found
    for ours, theirs in zip(lines, sharded_lines, strict=True):
        assert ours.keys() == theirs.keys()
        for name in ours:
            np.testing.assert_allclose(theirs[name], ours[name], rtol=1e-5, atol=1e-6, err_msg=name)
    for ours, theirs in zip(leaves, sharded, strict=True):
        np.testing.assert_allclose(theirs, ours, rtol=1e-5, atol=1e-6)
    text = loop._train_stretch.lower(*split(learner), *fixed[1:], state, mesh).compile().as_text()
    assert "all-reduce" in text, "the devices did not share the work"
print("same")
"""


def test_four_devices_give_the_losses_of_one():
    source = Path(odaf.__file__).parents[1]
    process = subprocess.run(
        [sys.executable, "-c", SHARDED, str(Path(__file__).parent)],
        env={**os.environ, "PYTHONPATH": str(source), "XLA_FLAGS": "--xla_force_host_platform_device_count=4"},
        capture_output=True,
        text=True,
        timeout=400,
    )
    assert process.stdout == "same\n", process.stderr


def test_devices_that_cannot_share_a_batch_are_refused():
    with pytest.raises(odaf.ConfigError, match="devices: must be from 1 to the"):
        loop.batch_mesh(1000, 1000)
    with pytest.raises(odaf.ConfigError, match="devices: must be from 1 to the"):
        loop.batch_mesh(0, 8)
