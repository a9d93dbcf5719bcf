"""The warm start: returns by brute force, a fit that learns the log, a training that begins from it."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from compilations import counted
from golden import tiny
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.ensemble_state import Models
from odaf.algorithms.warm_start import fit_to_log
from odaf.components.critics import CriticEnsemble, init_critics
from odaf.components.distributions import sample_tanh_gaussian, tanh_gaussian_log_density
from odaf.components.policies import init_gaussian_actor
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser, scale_actions
from odaf.data.returns_to_go import returns_to_go
from odaf.errors import ConfigError

SMALL = {"num_critics": 2, "hidden_sizes": (32, 32), "batch_size": 64, "warm_start": "returns", "discount": 0.9}


def _ignore(stage: str, done: int, steps: int) -> None:
    pass


def test_returns_are_the_discounted_sums_to_the_end_of_the_episode():
    rng = np.random.default_rng(0)
    lengths, ends = (4, 1, 6), (True, False, False)
    rewards = rng.normal(size=sum(lengths)).astype(np.float32)
    last = np.cumsum(lengths) - 1
    terminated, truncated = (np.zeros(len(rewards), bool) for _ in range(2))
    terminated[last[np.array(ends)]] = True
    truncated[last[~np.array(ends)]] = True
    dataset = Dataset.from_arrays(
        rng.normal(size=(len(rewards), 3)),
        rng.uniform(-1, 1, (len(rewards), 2)),
        rewards,
        next_observations=rng.normal(size=(len(rewards), 3)),
        terminated=terminated,
        truncated=truncated,
        action_bounds=(-1, 1),
    )
    found, start = returns_to_go(dataset, 0.9), 0
    for length, ended in zip(lengths, ends, strict=True):
        episode = rewards[start : start + length].astype(float)
        for row in range(length):
            total = sum(0.9**ahead * episode[row + ahead] for ahead in range(length - row))
            if not ended:
                total += 0.9 ** (length - row) * episode.mean() / (1 - 0.9)
            assert found[start + row] == pytest.approx(total, rel=1e-5)
        start += length


def test_the_density_of_an_action_is_that_of_the_draw_it_came_from():
    rng = np.random.default_rng(0)
    with tiny.exactly():
        mean, noise = tiny.floats(rng.normal(size=(7, 3))), tiny.floats(rng.normal(size=(7, 3)))
        log_std = tiny.floats(rng.uniform(-1.0, 0.3, (7, 3)))
        action, log_density = sample_tanh_gaussian(mean, log_std, noise)
        np.testing.assert_allclose(tanh_gaussian_log_density(mean, log_std, action), log_density, rtol=1e-6)


def _controlled(episodes: int = 40, length: int = 30) -> Dataset:
    """A controller without noise brings a linear system to rest; the reward is the first number of the state."""
    rng = np.random.default_rng(0)
    a = np.array([[0.9, 0.2, 0.0], [-0.1, 0.8, 0.1], [0.0, 0.1, 0.7]])
    gains = np.array([[-0.3, 0.2], [0.1, -0.4], [0.2, 0.3]])
    states = [rng.normal(size=(episodes, 3))]
    for _ in range(length):
        states.append(states[-1] @ a.T + 0.3 * np.tanh(states[-1] @ gains)[:, [0, 1, 0]])
    path = np.stack(states, axis=1)  # [episodes, length + 1, 3]
    before, after = path[:, :-1].reshape(-1, 3), path[:, 1:].reshape(-1, 3)
    ends = np.tile(np.arange(length) == length - 1, episodes)
    actions = np.tanh(before @ gains)
    return Dataset.from_arrays(
        before, actions, before[:, 0], next_observations=after, terminated=ends, action_bounds=(-1.0, 1.0)
    )


def test_the_fit_learns_the_logs_values_and_actions_and_training_begins_there():
    dataset = _controlled()
    learner, normaliser = EnsembleSAC(**SMALL, warm_start_steps=1500), Normaliser.fit(dataset.observations)
    spec, key = dataset.spec(), jr.key(0)
    models, report = learner.pretrain(dataset, normaliser, key, _ignore)
    assert jax.tree.structure(models) == jax.tree.structure(jax.eval_shape(lambda: learner.untrained(key, spec)))

    state, start = learner.init(jr.key(1), spec, models), models.warm_start
    assert state.terms == () and start is not None
    tiny.assert_same_bits(
        (state.actor.now, state.critics.now, state.critics.slow), (start.actor, start.critics, start.critics)
    )
    observations = jnp.asarray(normaliser.normalise(dataset.observations))
    scaled = jnp.asarray(scale_actions(dataset.actions, dataset.action_low, dataset.action_high))
    returns = returns_to_go(dataset, 0.9)
    low, high = np.asarray(state.value_bounds)
    error = np.mean((np.asarray(state.online_critics(observations, scaled)) - np.clip(returns, low, high)) ** 2)
    assert error < 0.2 * returns.var()
    assert report["warm_start"]["value_error_share"] < 0.2
    assert np.mean((np.asarray(state.actor.now.mode(observations)) - scaled) ** 2) < 0.02 * scaled.var()

    fresh = EnsembleSAC(**{**SMALL, "warm_start": "none"})
    assert fresh.untrained(jr.key(3), spec) == Models() == fresh.pretrain(dataset, normaliser, jr.key(4), _ignore)[0]


def test_either_side_can_be_fitted_alone():
    dataset = _controlled(4, 10)
    normaliser, sizes = Normaliser.fit(dataset.observations), (dataset.obs_dim, dataset.act_dim, (8,))
    actor_before = init_gaussian_actor(jr.key(0), *sizes)
    critics_before = CriticEnsemble(init_critics(jr.key(1), *sizes, num_critics=2, norm="none", output_bound=0.1))
    returns = returns_to_go(dataset, 0.9)

    def fitted(actor, critics, returns):
        given = {"steps": 20, "batch_size": 8, "learning_rate": 1e-3, "progress": lambda *done: None}
        return fit_to_log(actor, critics, dataset, normaliser, returns, jr.key(1), **given)

    both = fitted(actor_before, critics_before, returns)
    actor, nothing, about_actor = fitted(actor_before, None, None)
    assert nothing is None and list(about_actor) == ["action_log_density"]
    nothing, critics, about_critics = fitted(None, critics_before, returns)
    assert nothing is None and list(about_critics) == ["value_error_share"]
    for alone, together in ((actor, both[0]), (critics, both[1])):
        for ours, theirs in zip(jax.tree.leaves(alone), jax.tree.leaves(together), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-6)


def test_a_second_seed_and_another_step_size_compile_nothing():
    dataset = _controlled(4, 10)
    normaliser = Normaliser.fit(dataset.observations)

    def started(key: int, rate: float) -> None:
        learner = EnsembleSAC(**SMALL, warm_start_steps=2, critic_learning_rate=rate)
        learner.pretrain(dataset, normaliser, jr.key(key), _ignore)

    started(0, 1e-3)
    with counted() as programs:
        started(1, 2e-3)
    assert not programs


def test_the_target_entropy_can_be_that_of_the_logged_actions():
    # Actions uniform in [-0.5, 0.5]^2 whatever the state have an entropy of ln 1 = 0 nats. No other density can have a
    # smaller mean -log p over them, and a squashed Gaussian cannot quite have their shape.
    rng = np.random.default_rng(0)
    rows = 4000
    dataset = Dataset.from_arrays(
        rng.normal(size=(rows, 2)),
        rng.uniform(-0.5, 0.5, (rows, 2)),
        np.zeros(rows),
        next_observations=rng.normal(size=(rows, 2)),
        truncated=np.arange(rows) % 50 == 49,
        action_bounds=(-1.0, 1.0),
    )
    learner = EnsembleSAC(**SMALL, warm_start_steps=1500, target_entropy="log")
    models, report = learner.pretrain(dataset, Normaliser.fit(dataset.observations), jr.key(0), _ignore)
    state = learner.init(jr.key(1), dataset.spec(), models)
    assert float(state.target_entropy) == pytest.approx(-report["warm_start"]["action_log_density"])
    assert 0.0 <= float(state.target_entropy) < 0.3

    # The temperature steers to it: entropy above the target lowers alpha.
    def moved(target: float) -> float:
        batch = tiny.batch()
        small = EnsembleSAC(**tiny.SMALL, target_entropy=target)
        before = small.init(jr.key(0), tiny.SPEC, Models())
        after, _ = small.update(before, batch, jr.key(1))
        return float(after.log_temperature.now - before.log_temperature.now)

    assert moved(-50.0) < 0.0 < moved(50.0)


def test_without_a_warm_start_nothing_measures_the_logs_randomness():
    with pytest.raises(ConfigError, match="warm_start='returns'"):
        EnsembleSAC(target_entropy="log")
    for number, expected in ((None, -tiny.SPEC.act_dim), (-0.5, -0.5)):
        state = EnsembleSAC(**tiny.SMALL, target_entropy=number).init(jr.key(0), tiny.SPEC, Models())
        assert float(state.target_entropy) == expected


def _two_controllers(episodes: int = 30, length: int = 10) -> Dataset:
    """A tenth of the episodes push one way and earn 1 a row, the others push the other way and earn nothing."""
    rng = np.random.default_rng(0)
    rows = episodes * length
    good = np.repeat(np.arange(episodes) % 10 == 0, length)
    return Dataset.from_arrays(
        rng.normal(size=(rows, 3)),
        np.where(good, 0.6, -0.6)[:, None] + 0.01 * rng.normal(size=(rows, 1)),
        good.astype(float),
        next_observations=rng.normal(size=(rows, 3)),
        truncated=np.arange(rows) % length == length - 1,
        action_bounds=(-1.0, 1.0),
    )


@pytest.mark.parametrize("sampling", ["return", "best"])
def test_the_start_is_fitted_to_the_rows_that_batches_hold_where_asked_for(sampling):
    dataset = _two_controllers()
    normaliser = Normaliser.fit(dataset.observations)
    observations = jnp.asarray(normaliser.normalise(dataset.observations))

    def mean_action(**fields) -> tuple[float, float]:
        settings = {**SMALL, "hidden_sizes": (8,), "warm_start_steps": 400, "critic_learning_rate": 1e-2}
        learner = EnsembleSAC(**settings, sampling=sampling, **fields)
        start = learner.pretrain(dataset, normaliser, jr.key(0), _ignore)[0].warm_start
        assert start is not None
        actions = start.actor.mode(observations)
        return float(jnp.mean(actions)), float(jnp.mean(start.critics(observations, actions)))

    action, value = mean_action(warm_start_rows="drawn", return_temperature="auto")
    assert action == pytest.approx(0.6, abs=0.15) and value > 5.0, "the good ones earn 10 at this discount"
    assert mean_action(warm_start_rows="all")[0] < 0.0, "nine rows in ten push the other way"
    everything = EnsembleSAC(**SMALL, warm_start_rows="drawn")
    assert everything._warm_start_rows(dataset, jr.key(0)) is None, "uniform batches hold every row alike"
