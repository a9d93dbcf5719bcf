"""Fitted Q evaluation against decision problems whose values are known, and the front of all estimators."""

import dataclasses
import json

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from estimation.grounds import ACTION, HORIZON, SMALL, constant, gaussian, gliding, known_value
from odaf.errors import ConfigError, DatasetError
from odaf.estimation import estimate, fitted_q
from odaf.estimation.evidence import Evidence
from odaf.estimation.fitted_q import Transitions, fit_q
from odaf.estimation.recorded import resampled_rows


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
    )
    episodes = np.repeat(np.arange(300), copies * dataset.episode_lengths())
    table, _ = resampled_rows(episodes, 300, 4, np.random.default_rng(0))
    settings = dataclasses.replace(SMALL, batch_size=512).fitting()
    policies = np.stack([np.full((len(rows.rewards), 1, 1), action, np.float32) for action in (ACTION, -ACTION)])
    discounts = (1.0, 0.8)
    both = fit_q(
        rows, policies, table, HORIZON, discounts, jr.key(1), members=4, progress=lambda done, total: None, **settings
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


def test_networks_that_are_fitted_side_by_side_are_those_of_one_program(monkeypatch: pytest.MonkeyPatch):
    dataset, members = gliding(20, True), 3
    log = Evidence(dataset, HORIZON, (1.0, 0.8), dataclasses.replace(SMALL, members=members), jr.key(0))
    policies = np.random.default_rng(0).uniform(-1.0, 1.0, (2, len(dataset), 2, 1)).astype(np.float32)
    states, steps = dataset.observations[:5], np.array([1, 2, 3, 4, 5])
    found = []
    for parts in (1, 2, 6):
        monkeypatch.setattr(fitted_q, "parts_of", lambda nets, parts=parts: parts)
        settings = dataclasses.replace(SMALL, steps=40).fitting()
        both = fit_q(
            log.rows(), policies, log.member_rows, HORIZON, (1.0, 0.8), jr.key(1), members=members,
            progress=lambda done, total: None, **settings,
        )  # fmt: skip
        values = [each.values(states, policies[number, :5], steps) for number, each in enumerate(both)]
        found.append((np.stack(values), both[0].loss))
    for values, loss in found[1:]:
        np.testing.assert_allclose(values, found[0][0], rtol=1e-4, atol=1e-5)
        assert loss == pytest.approx(found[0][1], rel=1e-5)


def test_a_deterministic_policy_is_judged_by_fitted_q_alone_and_named():
    dataset = gliding(200, ends=True)
    policy = constant(dataset)
    calls = []
    found = estimate(policy, dataset, settings=SMALL, progress=lambda done, total: calls.append((done, total)))
    assert calls[-1] == (4_500, 4_500) and calls == sorted(calls)
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


def test_early_stopping_ends_fitted_q_by_an_error_on_episodes_that_no_member_learns_from(
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.setattr(fitted_q, "STRETCH", 20)
    dataset = gliding(40, ends=True)
    settings = dataclasses.replace(SMALL, steps=400, learning_rate=0.05, patience=1, early_stopping=True)
    log = Evidence(dataset, HORIZON, (1.0,), settings, jr.key(0))
    aside = np.unique(log.episode[log.held_out])
    assert len(aside) == 4 and not log.member_counts[:, aside].any()
    assert not np.isin(log.member_rows, log.held_out).any()
    made: list[int] = []
    fit_q(
        log.rows(),
        np.full((1, len(dataset), 1, 1), ACTION, np.float32),
        log.member_rows,
        HORIZON,
        (1.0,),
        jr.key(0),
        members=settings.members,
        progress=lambda done, total: made.append(done),
        held_out=log.held_out,
        patience=1,
        **settings.fitting(),
    )
    assert made[-1] < 400
    assert estimate(constant(dataset), dataset, method="fqe", settings=settings)["fqe"].value is not None


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
