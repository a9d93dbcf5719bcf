"""MOPO and COMBO against their formulas in float64 NumPy, and what their batches and rollouts are made of."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import networks, tiny, transitions
from odaf.algorithms.combo import COMBO
from odaf.algorithms.model_based import ModelBased, ModelBasedState, termination_errors
from odaf.algorithms.mopo import MOPO
from odaf.components import chunks
from odaf.components.critics import CriticEnsemble
from odaf.components.dynamics import EnsembleConfig
from odaf.components.dynamics.terminations import never
from odaf.components.trained import Trained
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError
from odaf.runs import presets

SMALL = {
    "hidden_sizes": (5, 4),
    "batch_size": tiny.ROWS,
    "dynamics": EnsembleConfig(hidden_sizes=(4,), members=3, elites=2),
    "rollout_rows": 8,
    "horizon": 2,
    "retained": 3,
    "real_fraction": 0.4,  # two rows of six
    "discount": 0.9,
    "target_rate": 0.25,
    "actor_learning_rate": 1e-2,
    "actor_decay_updates": 100,
    "critic_learning_rate": 2e-2,
    "temperature_learning_rate": 3e-2,
}
MOPO_SMALL = MOPO(**SMALL, penalty=1.5)
COMBO_SMALL = COMBO(**SMALL, conservative_weight=2.0, num_actions=3, penalty_temperature=0.5)
REAL = 2


@functools.cache
def _shape(learner: ModelBased):
    return eqx.filter_eval_shape(lambda: learner.init(jr.key(0), tiny.SPEC, learner.untrained(jr.key(1), tiny.SPEC)))


def _state(learner: ModelBased, alpha: float = 0.5, step: int = 0) -> ModelBasedState:
    """Different random networks and a model with random parameters."""
    shape = _shape(learner)
    empty = tiny.filled(shape, size=0.0)
    dynamics = tiny.filled(shape.dynamics, 5)
    positive = jnp.abs(dynamics.input_std) + 0.5, jnp.abs(dynamics.unit) + 0.5
    return dataclasses.replace(
        empty,
        step=empty.step + step,
        actor=Trained(tiny.filled(shape.actor.now, 1), None, empty.actor.moments),
        critics=Trained(tiny.filled(shape.critics.now, 3), tiny.filled(shape.critics.slow, 4), empty.critics.moments),
        log_temperature=Trained(tiny.floats(np.log(alpha)), None, empty.log_temperature.moments),
        dynamics=eqx.tree_at(lambda m: (m.input_std, m.unit), dynamics, positive),
    )


def _target(actor, state, batch, noise, alpha: float) -> np.ndarray:
    actions, density = networks.act(actor, batch.next_observations, noise)
    after = networks.q_values(CriticEnsemble(state.critics.slow), batch.next_observations, actions).min(axis=0)
    alive = 1.0 - networks.numbers(batch.terminated)
    return networks.numbers(batch.rewards) + 0.9 * alive * (after - alpha * density)


def _actor_loss(actor, critics, batch, noise, alpha: float) -> float:
    actions, density = networks.act(actor, batch.observations, noise)
    values = networks.q_values(CriticEnsemble(critics), batch.observations, actions).min(axis=0)
    return float(np.mean(alpha * density - values))


@pytest.mark.parametrize(("alpha", "counts"), [(0.5, 0.5), (3.0, 1.0)])
def test_mopo_steps_the_critics_first_with_an_alpha_of_at_most_one(alpha, counts):
    with tiny.exactly():
        state, batch = _state(MOPO_SMALL, alpha), tiny.batch()
        with tiny.recorded() as drawn:
            after, metrics = MOPO_SMALL.update(state, batch, jr.key(1))
        y = _target(state.actor.now, state, batch, drawn[0], counts)
        np.testing.assert_allclose(metrics["target/mean"], y.mean(), rtol=1e-9)
        values = networks.q_values(CriticEnsemble(state.critics.now), batch.observations, batch.actions)
        np.testing.assert_allclose(metrics["critic/loss"], np.sum(np.mean((values - y) ** 2, axis=1)), rtol=1e-8)
        loss = _actor_loss(state.actor.now, after.critics.now, batch, drawn[1], counts)
        np.testing.assert_allclose(metrics["actor/loss"], loss, rtol=1e-6)
        assert abs(loss - _actor_loss(state.actor.now, state.critics.now, batch, drawn[1], counts)) > 1e-4
        _, density = networks.act(state.actor.now, batch.observations, drawn[1])
        # alpha falls where the entropy is above -2, by the logarithm that has no bound
        moved = 3e-2 * np.sign(-density.mean() + 2.0)
        np.testing.assert_allclose(after.log_temperature.now, np.log(alpha) - moved, rtol=1e-4)
        np.testing.assert_allclose(metrics["rollouts/reward"], np.asarray(batch.rewards)[REAL:].mean(), rtol=1e-9)
    _assert_moved(state, after)


def _assert_moved(state, after) -> None:
    """Adam's first steps have the size of their rates; the slow critics go a quarter of the way."""
    for part, rate in (("actor", 1e-2), ("critics", 2e-2)):
        before, now = getattr(state, part).now, getattr(after, part).now
        steps = jax.tree.map(lambda a, b: np.abs(np.asarray(a) - np.asarray(b)).max(), before, now)
        np.testing.assert_allclose(max(jax.tree.leaves(steps)), rate, rtol=1e-3)
    expected = jax.tree.map(
        lambda slow, now: 0.75 * np.asarray(slow) + 0.25 * np.asarray(now), state.critics.slow, after.critics.now
    )
    tiny.assert_close(after.critics.slow, expected, atol=1e-9)
    assert int(after.step) == int(state.step) + 1
    tiny.assert_same_bits(after.dynamics, state.dynamics)


def test_the_actors_rate_falls_along_half_a_cosine():
    with tiny.exactly():
        state = _state(MOPO_SMALL, step=75)
        after, _ = MOPO_SMALL.update(state, tiny.batch(), jr.key(1))
        steps = jax.tree.map(lambda a, b: np.abs(np.asarray(a) - np.asarray(b)).max(), state.actor.now, after.actor.now)
        np.testing.assert_allclose(max(jax.tree.leaves(steps)), 1e-2 * 0.5 * (1 + np.cos(0.75 * np.pi)), rtol=1e-3)


def _combo_loss(learner, critics, actor, state, batch, noise, here, following, uniform) -> float:
    """L_Q row by row."""
    y = _target(actor, state, batch, noise, 0.0)
    logged = networks.q_values(CriticEnsemble(critics), batch.observations, batch.actions)
    sources = [[(networks.numbers(u), np.full(len(u), -tiny.ACT_DIM * np.log(2.0))) for u in uniform]]
    sources.append([networks.act(actor, batch.next_observations, one) for one in following])
    sources.append([networks.act(actor, batch.observations, one) for one in here])
    valued = [
        [(networks.q_values(CriticEnsemble(critics), batch.observations, a), d) for a, d in source]
        for source in sources
    ]
    t, total = learner.penalty_temperature, 0.0
    for k in range(2):
        soft = []
        for row in range(tiny.ROWS):
            terms = np.array([[np.exp((q[k, row] - d[row]) / t) for q, d in source] for source in valued])
            soft.append(
                t * (np.log(terms.sum()) if learner.soft_maximum == "all" else np.log(terms.sum(axis=0)).mean())
            )
        down = np.mean(soft) if learner.push_down == "mix" else np.mean(soft[REAL:])
        total += np.mean((logged[k] - y) ** 2) + learner.conservative_weight * (down - np.mean(logged[k, :REAL]))
    return float(total)


@pytest.mark.parametrize("changes", [{}, {"soft_maximum": "threes"}, {"push_down": "model"}])
def test_combo_presses_down_where_both_go_and_lifts_the_log_alone(changes, monkeypatch):
    learner = dataclasses.replace(COMBO_SMALL, **changes)
    monkeypatch.setattr(chunks, "ROWS_AT_ONCE", 30)  # 10 actions a state: three states at a time, twice
    with tiny.exactly():
        state, batch = _state(learner), tiny.batch()
        with tiny.recorded() as drawn, tiny.recorded("uniform") as uniform:
            gradient, metrics = learner.critic_gradient(state.actor.now, state, batch, jr.key(3))
        noise, here, following = drawn

        def expected(critics):
            return _combo_loss(learner, critics, state.actor.now, state, batch, noise, here, following, uniform[0])

        tiny.assert_slopes(gradient, expected, state.critics.now)
        error, weight = float(metrics["critic/loss"]), learner.conservative_weight
        penalty = expected(state.critics.now) - error
        np.testing.assert_allclose(2.0 * weight * float(metrics["conservative/gap"]), penalty, rtol=1e-8)


def test_combo_steps_the_actor_first_and_its_critics_see_the_new_one():
    with tiny.exactly():
        state, batch = _state(COMBO_SMALL), tiny.batch()
        with tiny.recorded() as drawn:
            after, metrics = COMBO_SMALL.update(state, batch, jr.key(1))
        loss = _actor_loss(state.actor.now, state.critics.now, batch, drawn[0], 0.5)
        np.testing.assert_allclose(metrics["actor/loss"], loss, rtol=1e-9)
        y, old = (_target(actor, state, batch, drawn[1], 0.0) for actor in (after.actor.now, state.actor.now))
        np.testing.assert_allclose(metrics["target/mean"], y.mean(), rtol=1e-7)  # without entropy
        assert abs(y.mean() - old.mean()) > 1e-5
    _assert_moved(state, after)


# ---- batches and rollouts ---------------------------------------------------------------------------------------


@functools.cache
def _columns():
    return tiny.batch(40, seed=9)


def _refreshed(learner, state=None, key=0):
    state = _state(learner) if state is None else state
    return jax.jit(learner.refresh)(state, _columns(), jr.key(key))


def test_rollouts_begin_at_logged_states_and_their_rewards_are_less_the_uncertainty_of_all_members():
    """The third member, which is no elite, is the least sure."""
    free = dataclasses.replace(MOPO_SMALL, penalty=0.0)
    state = _state(MOPO_SMALL)
    wild = state.dynamics.network.biases[-1].at[2, 4:].add(3.0)  # of the log-variances
    network = eqx.tree_at(lambda mlp: mlp.biases[-1], state.dynamics.network, wild)
    state = dataclasses.replace(state, dynamics=eqx.tree_at(lambda m: m.network, state.dynamics, network))
    penalised, plain = (_refreshed(learner, state).ring for learner in (MOPO_SMALL, free))
    assert int(penalised.filled) == 16 == int(penalised.head) and penalised.capacity == 48
    rows = jax.tree.map(lambda column: column[:16], penalised.rows)
    u = transitions.uncertainty(state.dynamics, rows.observations, rows.actions, "deviation")
    np.testing.assert_allclose(plain.rows.rewards[:16] - rows.rewards, 1.5 * u, rtol=1e-4, atol=1e-5)
    _, variance = transitions.moments(state.dynamics, rows.observations, rows.actions, 2)
    assert np.mean(np.isclose(u, np.sqrt(variance.sum(axis=1)))) > 0.5
    tiny.assert_same_bits(penalised.rows.next_observations, plain.rows.next_observations)
    logged = {tuple(row) for row in np.asarray(_columns().observations).tolist()}
    assert all(tuple(row) in logged for row in np.asarray(rows.observations[:8]).tolist())
    np.testing.assert_array_equal(rows.observations[8:], rows.next_observations[:8])


def test_combo_rolls_out_without_a_penalty_and_uniformly_where_asked():
    state = _state(COMBO_SMALL)
    ring = _refreshed(COMBO_SMALL, state).ring
    assert int(ring.filled) == 16
    spread = {}
    for kind in ("policy", "uniform"):
        learner = dataclasses.replace(COMBO_SMALL, rollout_actions=kind, rollout_rows=400)
        roll = jax.jit(functools.partial(learner.rolled, state))
        spread[kind] = np.asarray(roll(jnp.zeros((400, 3)), jr.key(0)).rows.actions[:400])
    mean, std = networks.gaussian(state.actor.now, np.zeros((1, 3)))
    # 400 draws: a mean is off by a twentieth of a deviation
    np.testing.assert_allclose(np.arctanh(spread["policy"]).mean(axis=0), mean[0], atol=0.25 * std.max())
    np.testing.assert_allclose(spread["uniform"].std(axis=0), 3.0**-0.5, rtol=0.1)


def test_the_ring_forgets_the_oldest_rollouts_first_and_all_of_them():
    state = _state(COMBO_SMALL)
    first = np.asarray(_refreshed(COMBO_SMALL, state, 0).ring.rows.rewards[:16])
    for key in range(4):
        state = _refreshed(COMBO_SMALL, state, key)
        assert (first[0] in np.asarray(state.ring.rows.rewards)) == (key < 3)
    assert int(state.ring.filled) == 48 and np.all(np.any(np.asarray(state.ring.rows.observations), axis=1))


def test_batches_are_rows_of_the_log_and_then_of_rollouts():
    state = _refreshed(MOPO_SMALL)
    batch = MOPO_SMALL.batch(state, _columns(), jr.key(5))
    logged, rolled = np.asarray(_columns().rewards), np.asarray(state.ring.rows.rewards[:16])
    assert np.isin(batch.rewards[:REAL], logged).all() and np.isin(batch.rewards[REAL:], rolled).all()
    assert batch.rewards.shape == (tiny.ROWS,) and not np.isin(rolled, logged).any()
    assert (MOPO().real_rows, COMBO().real_rows) == (12, 128)
    assert dataclasses.replace(MOPO_SMALL, real_fraction=0.05).real_rows == 1
    assert dataclasses.replace(MOPO_SMALL, real_fraction=0.0).real_rows == 0


def test_a_termination_that_does_not_fit_the_log_is_reported():
    """Three of four rows that end are seen by the function, and one row of eight is not an end."""
    states = np.zeros((12, 2))
    after = np.zeros((12, 2))
    after[[0, 1, 2, 5], 0] = 3.0
    terminated = np.isin(np.arange(12), [0, 1, 2, 3, 4])
    after[3, 1] = 1.0  # row 3 ends unseen, row 4 repeats its state and counts as nothing
    log = Dataset.from_arrays(
        states + np.arange(12)[:, None] * 0.0,
        np.zeros((12, 1)),
        np.arange(12.0),
        next_observations=after,
        terminated=terminated,
        truncated=np.arange(12) >= 5,
        action_bounds=(-1.0, 1.0),
    )

    def sees(observations, actions, next_observations):
        return next_observations[:, 0] > 2.0

    found = termination_errors(sees, log)
    assert found == {"ends": 4, "missed": 0.25, "invented": pytest.approx(1 / 7)}
    assert termination_errors(never, log) == {"ends": 4, "missed": 1.0, "invented": 0.0}
    with pytest.raises(ConfigError, match=r"termination='columns' gives bool of shape \(12, 1\) for 12 rows"):
        termination_errors(columns, log)
    with pytest.raises(ConfigError, match="termination='numbers' gives float32"):
        termination_errors(numbers, log)


def columns(observations, actions, next_observations):
    return next_observations[:, :1] > 2.0


def numbers(observations, actions, next_observations):
    return next_observations[:, 0]
    learner = dataclasses.replace(
        MOPO_SMALL,
        dynamics=EnsembleConfig(hidden_sizes=(4,), members=2, elites=1, epochs=1, epoch_steps=2, batch_size=4),
    )
    normaliser = Normaliser.fit(log.observations, 1e-3)
    _, report = learner.pretrain(log, normaliser, jr.key(0), lambda *_: None)
    assert any("termination='never' is wrong about 100 % of the log's true ends" in w for w in report["warnings"])
    assert not any("went on" in w for w in report["warnings"])
    assert report["dynamics"]["kind"] == "transition ensemble" and report["termination"]["ends"] == 4


# ---- presets and settings ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "task", "expected"),
    [
        ("mopo", "halfcheetah-medium-expert", (5, 2.5, "halfcheetah")),
        ("mopo", "hopper-medium-replay", (5, 2.5, "hopper")),
        ("mopo", "walker2d-medium", (5, 0.5, "walker2d")),
        ("mopo", "walker2d-random", (1, 1.0, "walker2d")),
        ("mopo", "pointmaze", (1, 2.5, "never")),
        ("combo", "halfcheetah-medium", (5, 0.5, "halfcheetah")),
        ("combo", "walker2d-medium-replay", (1, 0.5, "walker2d")),
        ("combo", "hopper-medium-expert", (5, 5.0, "hopper")),
        ("combo", "pointmaze", (5, 1.0, "never")),
    ],
)
def test_tasks_have_the_published_values(name, task, expected):
    learner = presets.load(name, task=task)
    weight = learner.penalty if name == "mopo" else learner.conservative_weight
    assert (learner.horizon, weight, learner.termination) == expected
    assert (learner.rollout_rows, learner.retained, learner.refresh_every) == (50_000, 5, 1_000)
    assert learner.dynamics == EnsembleConfig()
    assert len(presets.tasks(name)) == (13 if name == "mopo" else 10)
    updates = 3_000_000 if name == "mopo" else 1_000_000
    assert learner.actor_decay_updates == (100_000 if task == "pointmaze" else updates)
    assert presets.load(name) == (MOPO() if name == "mopo" else COMBO())


@pytest.mark.parametrize(
    ("kind", "fields", "message"),
    [
        (MOPO, {"penalty": -1.0}, "penalty=-1.0 must not be negative"),
        (MOPO, {"real_fraction": 1.0}, "real_fraction=1.0"),
        (MOPO, {"termination": "falls"}, "termination='falls' is not known"),
        (MOPO, {"temperature_max": -1.0}, "temperature_max=-1.0 must be positive"),
        (MOPO, {"horizon": 0}, "horizon=0 must be at least 1"),
        (MOPO, {"discount": 1.0}, "discount=1.0"),
        (MOPO, {"batch_size": 1}, "batch_size=1 leaves no row for rollouts"),
        (COMBO, {"conservative_weight": -1.0}, "conservative_weight=-1.0"),
        (COMBO, {"penalty_temperature": 0.0}, "penalty_temperature=0.0"),
        (COMBO, {"real_fraction": 0.0}, "real_fraction=0.0 must be above 0"),
    ],
)
def test_impossible_settings_are_named(kind, fields, message):
    with pytest.raises(ConfigError, match=message):
        kind(**fields)
