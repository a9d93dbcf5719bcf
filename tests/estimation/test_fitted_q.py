"""Fitted Q evaluation against decision problems whose values are known, and the front of all estimators."""

import dataclasses
import json

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from odaf.components.networks import init_mlp
from odaf.components.policies import DeterministicActor, GaussianActor
from odaf.data import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import ConfigError, DatasetError
from odaf.estimation import EstimateSettings, estimate
from odaf.estimation.fitted_q import Transitions, fit_q
from odaf.training.policy import Policy

SMALL = EstimateSettings(
    members=4, hidden_sizes=(32, 32), steps=1_500, batch_size=64, learning_rate=2e-3, resamples=200
)
HORIZON, CHANCE, ACTION = 5, 0.3, 0.4


def gliding(episodes: int, ends: bool, seed: int = 0, scale: float = 1.0) -> Dataset:
    """s' = 0.7 s + 0.3 a, reward s + a for uniform actions; where told, an end with probability 0.3 a step."""
    rng = np.random.default_rng(seed)
    columns: dict[str, list[float]] = {"s": [], "a": [], "r": [], "n": [], "d": [], "t": []}
    for _ in range(episodes):
        state = float(rng.uniform(-1, 1))
        for step in range(HORIZON):
            action = float(rng.uniform(-1, 1))
            ended = bool(ends and rng.random() < CHANCE)
            last = step == HORIZON - 1 and not ended
            following = 0.7 * state + 0.3 * action
            row = (state, action, scale * (state + action), following, ended, last)
            for name, value in zip("sarndt", row, strict=True):
                columns[name].append(value)
            if ended:
                break
            state = following
    s, a, r, n, d, t = (np.array(columns[name]) for name in "sarndt")
    uniform = np.full(len(s), np.log(0.5))
    return Dataset.from_arrays(
        s[:, None],
        a[:, None],
        r,
        n[:, None],
        d.astype(bool),
        t.astype(bool),
        action_bounds=(-1.0, 1.0),
        infos={"logp": uniform.astype(np.float32)},
    )


def known_value(states: np.ndarray, ends: float, discount: float = 1.0, action: float = ACTION) -> np.ndarray:
    """Expected sum to the horizon of a policy whose actions have this mean, where a step ends with this chance."""
    stays, total, states = 1.0, np.zeros(len(states)), states.astype(np.float64)
    for _ in range(HORIZON):
        total = total + stays * (states + action)
        states, stays = 0.7 * states + 0.3 * action, stays * discount * (1.0 - ends)
    return total


def constant(dataset: Dataset, action: float = ACTION) -> Policy:
    """Takes one action everywhere."""
    network = init_mlp(jr.key(0), (1, 4, 1))
    silent = dataclasses.replace(
        network,
        weights=(network.weights[0], jnp.zeros_like(network.weights[1])),
        biases=(network.biases[0], jnp.full((1,), np.arctanh(action), jnp.float32)),
    )
    return Policy(
        DeterministicActor(silent), Normaliser.fit(dataset.observations), (-1.0,), (1.0,), dataset.observation_names
    )


def gaussian(dataset: Dataset, mean: float, log_std: float) -> Policy:
    """tanh of one Gaussian everywhere."""
    network = init_mlp(jr.key(0), (1, 4, 2))
    silent = dataclasses.replace(
        network,
        weights=(network.weights[0], jnp.zeros_like(network.weights[1])),
        biases=(network.biases[0], jnp.asarray([mean, log_std], jnp.float32)),
    )
    return Policy(
        GaussianActor(silent), Normaliser.fit(dataset.observations), (-1.0,), (1.0,), dataset.observation_names
    )


@pytest.mark.parametrize("ends", [False, True])
def test_fitted_q_finds_the_known_values_of_two_policies_at_two_discounts(ends: bool):
    # Each row ten times, of which three end or none does: what is known of the chance is known of the log too.
    dataset, copies = gliding(300, False), 10
    ended = np.tile(np.arange(copies) < (3 if ends else 0), len(dataset))
    rows = Transitions(
        np.repeat(dataset.observations, copies, axis=0),
        np.repeat(dataset.actions, copies, axis=0),
        np.repeat(dataset.rewards, copies),
        ended,
        np.repeat(dataset.next_observations, copies, axis=0),
        np.repeat(np.arange(300), copies * dataset.episode_lengths()),
    )
    settings = dataclasses.replace(SMALL, batch_size=512).fitting()
    policies = np.stack([np.full((len(rows.rewards), 1, 1), action, np.float32) for action in (ACTION, -ACTION)])
    discounts = (1.0, 0.8)
    both = fit_q(
        rows, policies, 300, HORIZON, discounts, jr.key(1), members=4, progress=lambda done, total: None, **settings
    )
    states = np.array([[-0.5], [0.5]], np.float32)
    for found, action in zip(both, (ACTION, -ACTION), strict=True):
        actions = np.full((2, 1, 1), action, np.float32)
        reached = found.values(states, actions, np.array([HORIZON, HORIZON])).mean(axis=2)
        for (values, lengths), discount in zip(reached, discounts, strict=True):
            known = known_value(states[:, 0], ended.mean(), discount, action)
            np.testing.assert_allclose(values, known, atol=0.1)
            stays = discount * (1.0 - ended.mean())
            np.testing.assert_allclose(lengths, sum(stays**t for t in range(HORIZON)), atol=0.08)
        last = found.values(states, actions, np.array([1, 1])).mean(axis=2)[:, 0]
        np.testing.assert_allclose(last, [[action - 0.5, action + 0.5]] * 2, atol=0.08)


def test_a_deterministic_policy_is_judged_by_fitted_q_alone_and_named():
    dataset = gliding(200, ends=True)
    policy = constant(dataset)
    calls = []
    found = estimate(policy, dataset, settings=SMALL, progress=lambda done, total: calls.append((done, total)))
    assert calls[-1] == (3_000, 3_000) and calls == sorted(calls)
    fqe = found["fqe"]
    assert fqe.verdict == "better" and fqe.value is not None and fqe.difference is not None
    starts = dataset.observations[dataset.episode_starts, 0]
    truth = known_value(starts, float(dataset.terminated.mean())).mean()
    assert fqe.value.low < truth < fqe.value.high
    np.testing.assert_allclose(fqe.value.value, truth, atol=0.25)
    assert fqe.calibrated is not None
    assert fqe.calibrated.low < truth < fqe.calibrated.high
    np.testing.assert_allclose(fqe.calibrated.value, found.behaviour.value + fqe.difference.value)
    np.testing.assert_allclose(found.behaviour.value, dataset.episode_returns().mean())
    for name in ("wis", "pdis", "dr"):
        assert found[name].verdict == "refused" and found[name].value is None
        assert "DeterministicActor: is deterministic" in found[name].reason
    with pytest.raises(ConfigError, match="method=wis: DeterministicActor: is deterministic"):
        estimate(policy, dataset, method="wis", settings=SMALL)
    assert "DeterministicActor" in str(found) and "better" in str(found)
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["estimates"][0]["verdict"] == "better"


def test_estimates_scale_with_the_unit_of_the_reward():
    settings = dataclasses.replace(SMALL, steps=500)
    one, thousand = (
        estimate(constant(data), data, method="fqe", settings=settings)
        for data in (gliding(60, ends=True), gliding(60, ends=True, scale=1_000.0))
    )
    assert one["fqe"].verdict == thousand["fqe"].verdict
    for pick in (lambda found: found["fqe"].value, lambda found: found["fqe"].per_step, lambda found: found.behaviour):
        np.testing.assert_allclose(
            1_000.0 * np.array(dataclasses.astuple(pick(one))), dataclasses.astuple(pick(thousand)), rtol=2e-3
        )


def test_weighing_estimators_agree_with_the_truth_and_with_themselves():
    dataset = gliding(400, ends=False)
    policy = gaussian(dataset, 0.3, -0.2)
    draws = np.tanh(0.3 + np.exp(-0.2) * np.random.default_rng(0).normal(size=100_000)).mean()
    found = estimate(policy, dataset, acting="draws", log_probs="logp", settings=SMALL)
    truth = known_value(dataset.observations[dataset.episode_starts, 0], 0.0, action=float(draws)).mean()
    for name in ("fqe", "wis", "pdis", "dr"):
        value = found[name].value
        assert value is not None
        assert value.low - 0.1 < truth < value.high + 0.1, name
        assert found[name].verdict in ("better", "not decided"), found[name].reason
    effective = found["pdis"].effective_episodes
    assert effective is not None and 10 < effective < 400


def test_a_policy_that_wrote_the_log_is_worth_what_the_log_earned():
    dataset = gliding(40, ends=True)
    policy = gaussian(dataset, 0.3, -0.2)
    own = policy.actor.log_density(jnp.asarray(dataset.observations), jnp.asarray(dataset.actions))
    dataset = dataclasses.replace(dataset, infos={"logp": np.asarray(own)}, source="test")
    for method in ("wis", "pdis"):
        found = estimate(policy, dataset, method=method, acting="draws", log_probs="logp", settings=SMALL)
        each = found[method]
        assert each.value is not None and each.difference is not None
        np.testing.assert_allclose(dataclasses.astuple(each.value), dataclasses.astuple(found.behaviour), rtol=1e-5)
        np.testing.assert_allclose(dataclasses.astuple(each.difference), 0.0, atol=1e-5)
        assert each.verdict == "not decided" and each.effective_episodes is not None
        np.testing.assert_allclose(each.effective_episodes, 40.0)


def test_thin_overlap_is_refused_in_words():
    dataset = gliding(40, ends=False)
    far = gaussian(dataset, 2.0, -4.0)
    found = estimate(far, dataset, method="pdis", acting="draws", log_probs="logp", settings=SMALL)["pdis"]
    assert found.verdict == "refused" and "effective episodes of 40" in found.reason


def test_what_does_not_fit_is_refused():
    dataset = gliding(4, ends=False)
    policy = constant(dataset)
    with pytest.raises(ConfigError, match="as deployed it takes one action"):
        estimate(gaussian(dataset, 0.0, 0.0), dataset, method="dr", settings=SMALL)
    with pytest.raises(DatasetError, match="the policy's bounds are"):
        estimate(dataclasses.replace(policy, action_high=(2.0,)), dataset, settings=SMALL)
    with pytest.raises(DatasetError, match="the policy has level"):
        estimate(dataclasses.replace(policy, observation_names=("level",)), dataset, settings=SMALL)
    with pytest.raises(DatasetError, match="a single episode"):
        estimate(policy, dataset.select([0]), settings=SMALL)
    with pytest.raises(ConfigError, match="memebers: is no setting"):
        estimate(policy, dataset, memebers=2)
    with pytest.raises(ConfigError, match="members=1 must be at least 2"):
        estimate(policy, dataset, members=1)
    with pytest.raises(DatasetError, match="is no column of one number a row"):
        estimate(
            gaussian(dataset, 0.0, 0.0), dataset, method="pdis", acting="draws", log_probs="no", settings=SMALL, steps=1
        )
