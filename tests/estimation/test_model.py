"""Rollouts of a model of the plant: exact where the model is, and near the truth where it is learnt."""

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from estimation.grounds import ACTION, HORIZON, SMALL, constant, gaussian, gliding, known_value
from odaf.components.dynamics import DynamicsConfig, untrained
from odaf.components.dynamics.gaussian_ensemble import GaussianEnsembleDynamics
from odaf.components.networks import MLP
from odaf.components.policies import UnsquashedGaussianActor
from odaf.estimation import estimate
from odaf.estimation.evidence import Evidence
from odaf.estimation.model import FittedModel, PlantModel, Player

MEMBERS, STEPS, GAMMA = 2, 6, 0.9
DRIFT = np.array([0.1, -0.2])  # of the state, by member
CHANCE = np.array([0.25, 0.5])  # of an end, by member


def linear(weights: np.ndarray, biases: np.ndarray) -> MLP:
    """A stack of linear maps, without a hidden layer."""
    return MLP((jnp.asarray(weights, jnp.float32),), (jnp.asarray(biases, jnp.float32),), (), (), "relu")


def plant(low: float = -100.0, high: float = 100.0) -> PlantModel:
    """s' = s + (drift + a) / 2, r = 3 + 2 s, without noise: in the model's terms output * scale + shift."""
    dynamics = untrained(DynamicsConfig(kind="ensemble", hidden_sizes=(4,)), jr.key(0), 2, 1, members=MEMBERS)
    assert isinstance(dynamics, GaussianEnsembleDynamics)
    weights, biases = np.zeros((MEMBERS, 3, 4)), np.zeros((MEMBERS, 4))
    weights[:, 2, 0] = 1.0  # inputs are state, a zero, action; outputs means and log-variances of change and reward
    weights[:, 0, 1] = 1.0
    biases[:, 0] = DRIFT
    dynamics = dataclasses.replace(
        dynamics,
        network=linear(weights, biases),
        log_variance_max=jnp.full(2, -60.0),
        log_variance_min=jnp.full(2, -60.0),
        shift=jnp.asarray([0.0, 3.0]),
        scale=jnp.asarray([0.5, 2.0]),
    )
    logits = np.log(CHANCE / (1.0 - CHANCE))[:, None]
    return PlantModel(dynamics, linear(np.zeros((MEMBERS, 3, 1)), logits), jnp.full(2, low), jnp.full(2, high))


def by_hand(start: float, action: float, member: int, discount: float, high: float = 100.0) -> tuple[float, float]:
    state, runs, total, length = start, 1.0, 0.0, 0.0
    for step in range(STEPS):
        total += discount**step * runs * min(3.0 + 2.0 * state, high)
        length += discount**step * runs
        state = min(state + 0.5 * (DRIFT[member] + action), high)
        runs *= 1.0 - CHANCE[member]
    return total, length


@pytest.mark.parametrize("high", [100.0, 3.2])
def test_rollouts_of_a_known_plant_are_exact(high: float):
    dataset = gliding(3, ends=False)
    log = Evidence(dataset, STEPS, (GAMMA, 1.0), dataclasses.replace(SMALL, members=MEMBERS), jr.key(0))
    log.member_counts = np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 3.0]])
    policy = constant(dataset)
    fitted = FittedModel(plant(-100.0, high), log, 0.0, np.arange(3), jr.key(1))
    played = fitted.play(Player(policy.actor, np.array([5.0]), np.array([2.0]), draws=False))
    found = played.values
    starts = log.observations[log.starts, 0].astype(np.float64)
    for place, discount in enumerate((GAMMA, 1.0)):
        known = np.array([[by_hand(s, ACTION, m, discount, high) for s in starts] for m in range(MEMBERS)])
        np.testing.assert_allclose(found[place, :, 0], known.mean(axis=(0, 1)), rtol=1e-4)
        np.testing.assert_allclose(found[place, :, 1], (known[0, 0] + 2 * known[0, 1]) / 3, rtol=1e-4)
        np.testing.assert_allclose(found[place, :, 2], known[1, 2], rtol=1e-4)
    visited = played.visited
    assert visited.states.shape == (STEPS, MEMBERS * 3, 1)  # of every start, which are few
    np.testing.assert_allclose(visited.running[:, :3], 0.75 ** np.arange(STEPS)[:, None] * np.ones(3), rtol=1e-5)
    np.testing.assert_allclose(visited.running[:, 3:], 0.5 ** np.arange(STEPS)[:, None] * np.ones(3), rtol=1e-5)
    follows = np.minimum(starts + 0.5 * (DRIFT[1] + ACTION), high)
    np.testing.assert_allclose(visited.states[0, 3:, 0], follows, rtol=1e-4)
    np.testing.assert_allclose(visited.actions, np.full((STEPS, MEMBERS * 3, 1), ACTION), rtol=1e-5)
    np.testing.assert_allclose(visited.rewards[1, 3:], np.minimum(3.0 + 2.0 * follows, high), rtol=1e-4)


class _Mirror(UnsquashedGaussianActor):
    """Acts with what it sees."""

    def act(self, carry: Any, observations: Any, key: Any = None) -> Any:
        del key
        return observations, carry


def test_an_actor_sees_states_through_its_own_normaliser():
    dataset = gliding(3, ends=False)
    log = Evidence(dataset, 2, (1.0,), dataclasses.replace(SMALL, members=MEMBERS), jr.key(0))
    model = eqx.tree_at(lambda tree: tree.ends.biases[0], plant(), jnp.full((MEMBERS, 1), -60.0))
    fitted = FittedModel(model, log, 0.0, np.arange(3), jr.key(1))
    actor = _Mirror(linear(np.zeros((1, 1)), np.zeros(1)), jnp.zeros(1))
    found = fitted.play(Player(actor, np.array([0.5]), np.array([4.0]), draws=False)).values
    starts = log.observations[log.starts, 0].astype(np.float64)
    raw = dataset.observations[log.starts, 0].astype(np.float64)
    known = [3 + 2 * s + 3 + 2 * (s + 0.5 * (DRIFT.mean() + (r - 0.5) / 4.0)) for s, r in zip(starts, raw, strict=True)]
    np.testing.assert_allclose(found[0, 0, 0], np.mean(known), rtol=1e-4)


def test_a_learnt_model_finds_the_known_value_of_a_linear_plant_with_chance_ends():
    dataset = gliding(400, ends=True)
    settings = dataclasses.replace(SMALL, steps=3_000, batch_size=128)
    found = estimate(constant(dataset), dataset, method="model", discount=0.9, settings=settings)
    model = found["model"]
    starts = dataset.observations[dataset.episode_starts, 0]
    ends = float(dataset.terminated.mean())
    truth = known_value(starts, ends, 0.9).mean()
    assert model.value is not None and model.calibrated is not None and model.per_step is not None
    np.testing.assert_allclose(model.value.value, truth, atol=0.15)
    assert model.value.low < truth < model.value.high
    above = model.value.value - model.figures["control"]
    np.testing.assert_allclose(model.calibrated.value, found.behaviour.value + above)
    lasts = sum((0.9 * (1.0 - ends)) ** step for step in range(HORIZON))
    np.testing.assert_allclose(model.per_step.value, truth / lasts, rtol=0.1)
    assert model.verdict == "better" and abs(model.figures["control"] - found.behaviour.value) < 0.2


def test_the_blend_lies_between_both_calibrated_values_by_their_weights_and_says_what_divides_them():
    dataset = gliding(60, ends=True)
    settings = dataclasses.replace(SMALL, steps=300)
    found = estimate(gaussian(dataset, 0.3, -0.2), dataset, settings=settings)
    blend, fqe, model = (found[name] for name in ("blend", "fqe", "model"))
    assert blend.value and fqe.calibrated and model.calibrated and blend.difference
    by_fqe, by_model = (blend.figures[f"weight_{name}"] for name in ("fqe", "model"))
    np.testing.assert_allclose(by_fqe + by_model, 1.0)
    mean = by_fqe * fqe.calibrated.value + by_model * model.calibrated.value
    np.testing.assert_allclose(blend.value.value, mean)
    np.testing.assert_allclose(blend.difference.value, blend.value.value - found.behaviour.value)
    half = (blend.value.high - blend.value.low) / 2
    apart = np.sqrt(by_fqe * by_model) * abs(fqe.calibrated.value - model.calibrated.value)
    assert half > 3.18 * apart  # Student's factor for four members
    assert found.unlike_states is not None and 0.0 <= found.unlike_states <= 1.0
    alone = estimate(gaussian(dataset, 0.3, -0.2), dataset, method="blend", settings=settings)
    assert [each.method for each in alone.estimates] == ["blend"] and alone["blend"].value == blend.value
