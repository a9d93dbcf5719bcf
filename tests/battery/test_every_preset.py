"""One tiny update of every preset, on a small log; who adds a preset inherits it."""

import jax
import jax.random as jr
import numpy as np
import pytest

from battery import learners
from golden import tiny
from odaf.data.spec import Spec
from odaf.runs import presets
from odaf.training.loop import is_finite

SPEC = Spec(tiny.OBS_DIM, tiny.ACT_DIM, (-1.0, -1.0), (1.0, 1.0), -1.0, 2.0, True, 20)


@pytest.mark.parametrize("name", learners.PRESETS)
def test_a_preset_makes_an_update(name):
    learner = learners.of_preset(name)
    models = learner.untrained(jr.key(0), SPEC)
    start = learner.init(jr.key(1), SPEC, models)
    batch = learner.batch(start, tiny.batch(12, extras=learner.view().extras), jr.key(2))
    state, metrics, updates = start, {}, getattr(learner, "actor_delay", 1)
    for number in range(updates):  # op by op: presets share what is compiled
        state, metrics = learner.update(state, batch, jr.key(number))
    assert int(state.step) == updates and is_finite(learner.actor(state))
    for term in getattr(learner, "terms", ()):
        assert any(metric.startswith(f"{term.name}/") for metric in metrics), term.name
    for part in ("actor", "critics", "network"):
        if hasattr(state, part):
            pair = getattr(start, part), getattr(state, part)
            assert any(not np.array_equal(a, b) for a, b in zip(*map(jax.tree.leaves, pair), strict=True)), part
    assert all(np.isfinite(float(value)) for value in metrics.values())
    assert jax.tree.structure(state) == jax.tree.structure(start)
    actions, _ = learner.actor(state).act(learner.actor(state).begin(6), batch.observations)
    assert actions.shape == (6, tiny.ACT_DIM) and float(np.abs(actions).max()) <= 1.0


@pytest.mark.parametrize("name", learners.PRESETS)
def test_a_preset_says_what_it_is_and_where_its_numbers_come_from(name):
    fields = presets.settings(name)
    assert fields.get("description") and fields.get("source")
