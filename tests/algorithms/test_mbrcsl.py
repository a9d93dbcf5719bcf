"""MBRCSL against its formulas, in float64 NumPy; what is imagined, what of it is kept, and what updates look at."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import networks, tiny
from odaf.algorithms import mbrcsl
from odaf.algorithms.mbrcsl import MBRCSL, decayed, imitation_loss
from odaf.components import imagined
from odaf.components.diffusion import init_action_diffusion
from odaf.components.diffusion_fit import DiffusionConfig
from odaf.components.dynamics import EnsembleConfig
from odaf.components.imagined import Imagined, Range, Rollouts, keep, report_of, returns_to_go, roll_out
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError, DivergenceError
from odaf.runs import presets

STEPS = 4
LEARNER = MBRCSL(
    num_rollouts=10, round_size=6, max_rounds=3, rollout_steps=STEPS, hidden_sizes=(5, 4), batch_size=tiny.ROWS
)


def _imagined(seed: int = 0, rollouts: int = 10) -> Imagined:
    rng = np.random.default_rng(seed)
    return Imagined(
        tiny.floats(rng.normal(size=(rollouts, STEPS, tiny.OBS_DIM))),
        tiny.floats(rng.uniform(-1.0, 1.0, (rollouts, STEPS, tiny.ACT_DIM))),
        tiny.floats(rng.uniform(0.0, 9.0, (rollouts, STEPS))),
    )


def _state(learner: MBRCSL = LEARNER, **changes: Any):
    state = learner.init(jr.key(0), tiny.SPEC, _imagined())
    now = tiny.filled(state.network.now, 1)
    return dataclasses.replace(state, network=dataclasses.replace(state.network, now=now), **changes)


# ---- stage 4 -------------------------------------------------------------------------------------------------------


def test_an_update_is_a_step_of_adam_on_the_squared_error_with_the_l2_term_in_its_gradient():
    learner = dataclasses.replace(LEARNER, weight_decay=0.3, learning_rate=0.01)
    state = _state(learner)
    batch = learner.batch(state, tiny.batch(), jr.key(1))
    known = networks.numbers(state.imagined.returns_to_go)
    np.testing.assert_allclose([state.mean, state.std], [known.mean(), known.std()], rtol=1e-5)
    with tiny.exactly():
        state, batch = tiny.in_double(state), tiny.in_double(batch)
        network = state.network.now
        returns = networks.numbers(batch.extras["returns_to_go"])
        asked = ((returns - float(state.mean)) / float(state.std))[:, None]

        def expected(network) -> float:
            inputs = np.concatenate([networks.numbers(batch.observations), asked], axis=1)
            return float(np.mean((networks.mlp(network, inputs) - networks.numbers(batch.actions)) ** 2))

        def loss(network):
            return imitation_loss(
                state.actor(network), batch.observations, batch.extras["returns_to_go"], batch.actions
            )

        value, gradient = jax.value_and_grad(loss)(network)
        np.testing.assert_allclose(value, expected(network), rtol=1e-9)
        tiny.assert_slopes(gradient, expected, network)

        def regularised(network) -> float:
            return expected(network) + 0.5 * 0.3 * sum(float(np.sum(leaf**2)) for leaf in jax.tree.leaves(network))

        whole = decayed(gradient, network, 0.3)
        tiny.assert_slopes(whole, regularised, network)
        after, metrics = learner.update(state, batch, jr.key(2))
        for new, old, slope in zip(*map(jax.tree.leaves, (after.network.now, network, whole)), strict=True):
            slope = networks.numbers(slope)  # Adam's first step: the moments are the slope and its square
            np.testing.assert_allclose(new - old, -0.01 * slope / (np.abs(slope) + 1e-8), rtol=1e-6)
        np.testing.assert_allclose(metrics["actor/loss"], value, rtol=1e-9)
        outside = networks.mlp(network, np.concatenate([networks.numbers(batch.observations), asked], axis=1))
    assert np.abs(outside).max() > 1.0, "the error is that of actions that are not cut"


def test_returns_stay_as_they_are_where_that_is_asked_for():
    state = _state(dataclasses.replace(LEARNER, normalise_returns=False))
    assert (float(state.mean), float(state.std)) == (0.0, 1.0)
    assert float(state.start) == float(jnp.max(state.imagined.returns_to_go[:, 0]))
    assert float(_state().std) != 1.0


def test_updates_see_imagined_steps_that_are_not_held_out_and_no_row_of_the_log():
    learner = dataclasses.replace(LEARNER, batch_size=400, holdout=0.3)
    state = _state(learner)
    batch = learner.batch(state, tiny.batch(), jr.key(0))
    known = np.asarray(state.imagined.returns_to_go)
    assert set(np.asarray(batch.extras["returns_to_go"])) == set(known[:7].ravel()), "all of seven, none of three"
    place = np.argmax(known.ravel()[None] == np.asarray(batch.extras["returns_to_go"])[:, None], axis=1)
    for column, source in ((batch.observations, state.imagined.observations), (batch.actions, state.imagined.actions)):
        np.testing.assert_array_equal(column, np.asarray(source).reshape(-1, source.shape[2])[place])
    held = learner.holdout_error(state, state.network.now)
    parts = (part[7:].reshape(-1, *part.shape[2:]) for part in jax.tree.leaves(state.imagined))
    observations, actions, returns = parts
    np.testing.assert_allclose(held, imitation_loss(state.actor(state.network.now), observations, returns, actions))


def test_the_best_policy_is_kept_and_settled_after_so_many_looks_without_a_gain():
    learner = dataclasses.replace(LEARNER, patience=2, earliest_stop=7)
    good = _state(learner)
    bad = jax.tree.map(lambda leaf: 10.0 * leaf, good.network.now)
    error = float(learner.holdout_error(good, good.network.now))

    def with_network(state, network, step):
        trained = dataclasses.replace(state.network, now=network)
        return dataclasses.replace(state, network=trained, step=jnp.asarray(step))

    slightly = dataclasses.replace(good, lowest=jnp.asarray(error * 1.005))
    tiny.assert_same_bits(learner.looked_at(slightly).best, slightly.best)  # half a per cent is no gain
    state = learner.looked_at(dataclasses.replace(good, lowest=jnp.asarray(error * 1.02)))
    tiny.assert_same_bits(state.best, good.network.now)
    np.testing.assert_allclose(state.lowest, error, rtol=1e-5)
    for step, looks, settled in ((5, 0, False), (6, 0, False), (7, 1, False), (8, 2, True)):
        state = learner.looked_at(with_network(state, bad, step))
        assert (int(state.looks), bool(state.settled)) == (looks, settled)
        tiny.assert_same_bits(learner.actor(state).network, good.network.now)
    better = with_network(dataclasses.replace(state, lowest=jnp.asarray(1e9)), bad, 9)
    tiny.assert_same_bits(learner.actor(better).network, good.network.now)  # settled is settled
    unsettled = dataclasses.replace(better, settled=jnp.asarray(False))
    tiny.assert_same_bits(learner.actor(unsettled).network, bad)  # the present one may be the best
    last = dataclasses.replace(learner, patience=None)
    tiny.assert_same_bits(last.actor(with_network(state, bad, 9)).network, bad)


def test_the_policy_does_what_earned_the_return_that_it_is_asked_for():
    rng = np.random.default_rng(0)
    high = np.arange(10) % 2 == 0
    returns = np.where(high, 90.0, 20.0)[:, None] - np.arange(STEPS)[None]
    actions = np.where(high, 0.5, -0.5)[:, None, None] + np.zeros((10, STEPS, 1))
    episodes = Imagined(*map(tiny.floats, (rng.normal(size=(10, STEPS, 3)), actions, returns)))
    learner = dataclasses.replace(LEARNER, learning_rate=0.01, weight_decay=0.0, hidden_sizes=(16,))
    spec = dataclasses.replace(tiny.SPEC, act_dim=1, action_low=(-1.0,), action_high=(1.0,))
    state = learner.init(jr.key(0), spec, episodes)

    @jax.jit
    def step(state, key):
        return learner.update(state, learner.batch(state, tiny.batch(), key), key)[0]

    for number in range(150):
        state = step(state, jr.key(number))
    actor, rows = learner.actor(state), jnp.zeros((2, 3))
    assert float(actor.start) == 90.0
    done, _ = actor.act(jnp.asarray([88.0, 18.0]), rows)
    np.testing.assert_allclose(done[:, 0], [0.5, -0.5], atol=0.1)
    carry = actor.observe(actor.begin(2), jnp.asarray([2.0, 72.0]))
    np.testing.assert_allclose(actor.act(carry, rows)[0], done, atol=1e-6)


# ---- stage 3 -------------------------------------------------------------------------------------------------------


def test_what_is_still_earned_is_not_discounted_and_counts_the_steps_own_reward():
    rewards = np.array([[1.0, -2.0, 4.0], [0.5, 0.0, 0.25]], np.float32)
    np.testing.assert_array_equal(returns_to_go(rewards), [[3.0, 2.0, 4.0], [0.75, 0.25, 0.25]])


def _round(returns: list[float]) -> Rollouts:
    """Rollouts of two steps, which their first observation names."""
    earned = np.asarray(returns, np.float32)
    rewards = np.stack([0.25 * earned, 0.75 * earned], axis=1)
    return Rollouts(np.repeat(earned, 2).reshape(-1, 2, 1), np.zeros((len(earned), 2, 1), np.float32), rewards)


def test_rollouts_are_kept_whole_as_they_come_where_they_earn_more_than_the_bar():
    seen = []
    rounds = iter([_round([5.0, 1.0, 4.0]), _round([9.0, 4.5, 8.0]), _round([7.0])])
    kept = keep(rounds, 4.0, 3, lambda *done: seen.append(done))
    np.testing.assert_array_equal(kept.rollouts.returns(), [5.0, 9.0, 4.5])  # 4 is not above 4; 8 came too late
    np.testing.assert_array_equal(kept.rollouts.observations[:, 1, 0], [5.0, 9.0, 4.5])
    assert (kept.passes, kept.rounds, len(kept.returns), seen) == (3, 2, 6, [(1, 3), (3, 3)])
    assert len(list(rounds)) == 1, "the third was not asked for"


def test_the_best_others_fill_what_is_missing_and_what_is_not_finite_comes_last():
    kept = keep([_round([1.0, np.inf, 5.0]), _round([3.0, np.nan, 2.0])], 4.0, 4, lambda *_: None)
    np.testing.assert_array_equal(kept.rollouts.returns(), [5.0, 3.0, 2.0, 1.0])
    assert kept.passes == 1
    kept = keep([_round([1.0, np.inf])], 4.0, 2, lambda *_: None)
    assert kept.rollouts.returns()[1] == -np.inf
    with pytest.raises(DivergenceError, match="rollouts: 1 of the 2 best imagined episodes are not finite"):
        report_of(kept, 4.0, Range.endless(1), tiny.SPEC)


def test_episodes_that_leave_what_the_log_has_shown_are_counted():
    known = Range.of(np.array([[0.0], [7.0]]), np.zeros(2))  # to 7.35 with its margin
    kept = keep([_round([9.0, 7.25, 2.0, 5.0, 8.0, 3.0])], 4.0, 5, lambda *_: None)
    report = report_of(kept, 4.0, known, dataclasses.replace(tiny.SPEC, reward_max=99.0, ever_terminates=False))
    assert (report["passed"], report["kept_passed"], report["kept_outside"]) == (4, 4, 2)
    assert [warning.split(";")[0] for warning in report["warnings"]] == [
        "rollouts: 4 of 6 imagined episodes pass, which is to earn more than the best logged one (4), so 1 of the "
        "others are learned from, too",
        "rollouts: 2 of the 5 episodes that are learned from leave the range of the logged states, where nobody knows "
        "what follows",
    ]


def test_a_rollout_is_played_by_the_behaviour_in_the_dynamics():
    config = EnsembleConfig(hidden_sizes=(5,), members=1, elites=1)
    model = tiny.filled(jax.eval_shape(lambda: config.untrained(jr.key(0), 3, 2)), 1, 0.3)
    model = dataclasses.replace(  # log-variances of -30: no noise
        model,
        log_variance_max=jnp.full(4, -30.0),
        log_variance_min=jnp.full(4, -30.0),
        input_std=jnp.ones(5),
        unit=jnp.ones(3),
    )
    behaviour = tiny.filled(jax.eval_shape(lambda: init_action_diffusion(jr.key(0), 3, 2, (5,), 3)), 2, 0.05)
    starts = jnp.asarray(np.random.default_rng(0).normal(size=(7, 3)), jnp.float32)
    states, actions, rewards = roll_out(model, behaviour, Range.endless(3), starts, jr.key(3), STEPS)
    assert states.shape == (STEPS, 7, 3) and actions.shape == (STEPS, 7, 2) and rewards.shape == (STEPS, 7)
    np.testing.assert_array_equal(states[0], starts)
    assert float(jnp.abs(actions).max()) <= 1.0
    assert len(np.unique(np.asarray(actions)[..., 0])) > 10, "each step and row draws anew"
    for step in range(STEPS):
        mean, _ = model.moments(states[step], actions[step])
        after, earned = model.transition(states[step], mean[0])
        np.testing.assert_allclose(rewards[step], earned, atol=1e-4)
        if step + 1 < STEPS:
            np.testing.assert_allclose(states[step + 1], after, atol=1e-4)
    low, high = np.full(3, -0.5, np.float32), np.asarray(np.median(np.asarray(states[1]), axis=0))
    middle = float(jnp.median(rewards[0]))
    cut, _, earned = roll_out(model, behaviour, Range(low, high, -np.inf, middle), starts, jr.key(3), STEPS)
    np.testing.assert_allclose(cut[1], np.clip(states[1], low, high), atol=1e-5)
    np.testing.assert_allclose(earned[0], np.minimum(rewards[0], middle), atol=1e-5)
    assert np.any(cut[1] != states[1]) and np.any(earned[0] != rewards[0])


# ---- stages 1 to 3, with models that are not trained --------------------------------------------------------------


def _log() -> Dataset:
    rewards = np.tile([0.0, 1.0, 1.0, 1.0], 5)
    ends = np.arange(20) % 4 == 3
    rng = np.random.default_rng(0)
    states, after = rng.normal(size=(2, 20, tiny.OBS_DIM))
    actions = rng.uniform(-1.0, 1.0, (20, tiny.ACT_DIM))
    return Dataset.from_arrays(
        states, actions, rewards, next_observations=after, truncated=ends, action_bounds=(-1.0, 1.0)
    )


def _pretrained(monkeypatch, earned: float, learner: MBRCSL = LEARNER):
    """Models, report, and the starts of every round, where one episode in three earns the given return."""
    starts, seen = [], []
    models = {
        "fit_transitions": EnsembleConfig(hidden_sizes=(4,), members=1, elites=1).untrained(jr.key(0), 3, 2),
        "fit_action_diffusion": init_action_diffusion(jr.key(0), 3, 2, (4,), 2),
    }
    for name, model in models.items():
        monkeypatch.setattr(mbrcsl, name, lambda *_, model=model, name=name: (model, {"warnings": [name]}))

    def played(dynamics, behaviour, bounds, first, key, steps):
        seen.append(bounds)
        starts.append(np.asarray(first))
        states = np.repeat(np.asarray(first)[None], steps, axis=0)
        rewards = np.zeros((steps, len(first)), np.float32)
        rewards[1, ::3] = earned
        return states, np.zeros((steps, len(first), tiny.ACT_DIM), np.float32), rewards

    monkeypatch.setattr(imagined, "roll_out", played)
    dataset = _log()
    normaliser = Normaliser.fit(dataset.observations)
    models, report = learner.pretrain(dataset, normaliser, jr.key(0), lambda *_: None)
    states = normaliser.normalise(dataset.observations)
    known = Range.of(states, dataset.rewards) if learner.within_log else Range.endless(tiny.OBS_DIM)
    tiny.assert_same_bits(seen[0], known)
    return models, report, np.concatenate(starts), states[::4]


def test_rollouts_begin_where_logged_episodes_began_and_pass_the_best_of_them(monkeypatch):
    learner = dataclasses.replace(LEARNER, max_rounds=9)
    models, report, starts, first = _pretrained(monkeypatch, 3.5, learner)
    assert starts.shape == (30, 3)  # five rounds of six, two of which pass
    found = np.abs(starts[:, None] - first[None]).max(axis=2).min(axis=1)
    assert found.max() < 1e-6 and len(np.unique(starts[:, 0])) == 5, "from all five, and from nowhere else"
    of_rollouts = report["rollouts"]
    assert (of_rollouts["best_logged_return"], of_rollouts["rounds"], of_rollouts["played"]) == (3.0, 5, 30)
    assert (of_rollouts["passed"], of_rollouts["kept"], of_rollouts["kept_passed"]) == (10, 10, 10)
    assert report["warnings"] == ["fit_transitions", "fit_action_diffusion"]
    assert all(report[stage]["seconds"] >= 0.0 for stage in ("dynamics", "behaviour", "rollouts"))
    np.testing.assert_array_equal(models.returns_to_go, np.tile([3.5, 3.5, 0.0, 0.0], (10, 1)))
    blank = jax.eval_shape(lambda: learner.untrained(jr.key(0), _log().spec()))
    assert jax.tree.structure(models) == jax.tree.structure(blank)
    assert not np.array_equal(models.observations[:, 0], starts[np.arange(30) % 3 == 0]), "in another order"


@pytest.mark.parametrize(
    ("earned", "said"),
    [
        (3.0, "0 of 18 imagined episodes pass, which is to earn more than the best logged one (3), so 10 of the"),
        (5.0, "an imagined episode earns 5, more than 4 of the largest logged rewards (4)"),
    ],
)
def test_what_is_short_or_dreamt_is_said(monkeypatch, earned, said):
    models, report, _, _ = _pretrained(monkeypatch, earned, dataclasses.replace(LEARNER, within_log=False))
    assert np.count_nonzero(np.asarray(models.returns_to_go)[:, 0] == earned) == 6, "the six best of 18"
    assert any(said in warning for warning in report["warnings"]), report["warnings"]


# ---- settings ------------------------------------------------------------------------------------------------------


def test_presets_are_as_published_or_say_what_is_ours():
    ours, maze = presets.load("mbrcsl"), presets.load("mbrcsl-pointmaze")
    assert ours == MBRCSL()
    assert (ours.weight_decay, maze.weight_decay) == (1e-3, 0.1)
    assert (maze.rollout_steps, maze.max_rounds, maze.normalise_returns, maze.within_log) == (200, 1000, False, False)
    assert maze.behaviour == dataclasses.replace(DiffusionConfig(), hidden_sizes=(512, 512, 512))
    assert MBRCSL().sizes(tiny.SPEC) == (20,) and maze.sizes(tiny.SPEC) == (200,)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"num_rollouts": 1}, "num_rollouts=1"),
        ({"max_rounds": 2, "round_size": 10}, "num_rollouts=100: only 20 are imagined"),
        ({"rollout_steps": 0}, "rollout_steps=0"),
        ({"patience": 0}, "patience=0"),
        ({"refresh_every": 0}, "refresh_every=0"),
        ({"holdout": 1.0}, "holdout=1.0"),
        ({"weight_decay": -0.1}, "weight_decay=-0.1"),
    ],
)
def test_impossible_settings_are_named(changes, named):
    with pytest.raises(ConfigError, match=named):
        MBRCSL(**changes)
