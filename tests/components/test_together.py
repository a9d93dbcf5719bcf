"""Fits of many trainings in one program: each gets what it gets alone, and one that fails lets the others go on."""

import threading

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from compilations import counted
from golden import tiny
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.terms import OutcomePenalty
from odaf.components import fitting, together
from odaf.data.normalisation import Normaliser
from odaf.errors import DivergenceError


def _loss(model, batch, key):
    x, y = batch
    noise = 0.01 * jr.normal(key, (x.shape[0],))
    error = x @ model - y + noise
    return jnp.mean(jnp.square(error)), {"largest": jnp.max(jnp.abs(error))}


def _fitted(seed: int, steps: int = 25, rate: float = 0.05):
    rng = np.random.default_rng(seed)
    x = jnp.asarray(rng.normal(size=(40, 3)), jnp.float32)
    y = x @ jnp.asarray(rng.normal(size=3), jnp.float32)
    return fitting.fit(
        jnp.zeros(3), _loss, (x, y), steps=steps, batch_size=8, learning_rate=rate, key=jr.key(seed), what="line",
        remedy="none", progress=lambda done, total: None, stretch=10,
    )  # fmt: skip


def test_each_gets_what_it_gets_alone_whatever_the_others_ask_for():
    asked = [(0, 25, 0.05), (1, 25, 0.1), (2, 13, 0.05), (3, 25, 0.05)]  # the third ends before the others
    alone = [_fitted(*one) for one in asked]
    found = together.run_together([lambda one=one: _fitted(*one) for one in asked], 4)
    for ours, theirs in zip(found, alone, strict=True):
        assert isinstance(ours, fitting.Fitted) and ours.steps == theirs.steps
        np.testing.assert_allclose(ours.model, theirs.model, rtol=1e-5, atol=1e-6)
        assert ours.means == pytest.approx(theirs.means, rel=1e-4)


def test_they_share_programs_and_later_ones_compile_nothing():
    together.run_together([lambda seed=seed: _fitted(seed) for seed in range(3)], 3)
    with counted() as programs:
        together.run_together([lambda seed=seed: _fitted(seed) for seed in range(3, 6)], 3)
    assert not programs


def test_one_that_diverges_is_told_and_the_others_go_on():
    found = together.run_together([lambda: _fitted(0), lambda: _fitted(1, rate=float("nan")), lambda: _fitted(2)], 3)
    assert isinstance(found[1], DivergenceError)
    for place in (0, 2):
        ours = found[place]
        assert isinstance(ours, fitting.Fitted)
        np.testing.assert_allclose(ours.model, _fitted(place).model, rtol=1e-5, atol=1e-6)


def test_an_interruption_leaves_nobody_waiting(monkeypatch):
    def interrupted(self, group):
        raise KeyboardInterrupt

    monkeypatch.setattr(together._Meeting, "_answer", interrupted)
    before = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        together.run_together([lambda: _fitted(0), lambda: _fitted(1)], 2)
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and thread.name.endswith("(work)"):
            thread.join(10)
    assert threading.active_count() <= before


def test_alone_and_in_one_thread_it_is_a_plain_call():
    (only,) = together.run_together([lambda: _fitted(4)], 1)
    assert isinstance(only, fitting.Fitted)
    np.testing.assert_array_equal(only.model, _fitted(4).model)
    assert jax.tree.leaves(only.means)


def test_bits_belong_to_the_number_of_lanes_and_not_to_who_else_is_there():
    both = together.run_together([lambda: _fitted(0), lambda: _fitted(1)], 4)
    (alone,) = together.run_together([lambda: _fitted(1)], 4)
    assert isinstance(alone, fitting.Fitted) and isinstance(both[1], fitting.Fitted)
    np.testing.assert_array_equal(alone.model, both[1].model)


def test_models_of_real_learners_are_each_trainings_own():
    log = tiny.linear_dataset(episodes=6, length=20)
    normaliser = Normaliser.fit(log.observations)
    term = OutcomePenalty(dynamics=tiny.dynamics_config(steps=30))
    learner = EnsembleSAC(**tiny.SMALL, terms=(term,), warm_start="returns", warm_start_steps=30)

    def pretrained(seed: int):
        return learner.pretrain(log, normaliser, jr.key(seed), lambda *_: None)

    found = together.run_together([lambda seed=seed: pretrained(seed) for seed in (0, 5)], 2)
    for seed, outcome in zip((0, 5), found, strict=True):
        assert isinstance(outcome, tuple)
        models, report = pretrained(seed)
        tiny.assert_close(outcome[0], models, rtol=1e-3, atol=1e-5)
        assert outcome[1].keys() == report.keys() > {"outcome", "warm_start"}
