"""Denoising of actions against its formulas in float64 NumPy, by Bayes' rule; and two modes are learnt as two."""

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import networks, tiny
from odaf.components import diffusion_fit
from odaf.components.diffusion import ActionDiffusion, init_action_diffusion, squared_cosine
from odaf.components.diffusion_fit import DiffusionConfig, fit_action_diffusion
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.row_choice import RowChoice
from odaf.data.view import View
from odaf.errors import ConfigError

STEPS = 4


def _model() -> ActionDiffusion:
    sizes = tiny.OBS_DIM, tiny.ACT_DIM, (5, 4), STEPS
    return tiny.filled(jax.eval_shape(lambda: init_action_diffusion(jr.key(0), *sizes)), 1)


def _kept(steps: int) -> np.ndarray:
    """Shares of the action's variance: the products telescope, and only the last factor is capped."""

    def level(u: float) -> float:
        return np.cos((u + 0.008) / 1.008 * np.pi / 2) ** 2

    kept = [level((step + 1) / steps) / level(0.0) for step in range(steps)]
    kept[-1] = kept[-2] * (1.0 - 0.999)
    return np.array(kept)


def _noise_in(model: ActionDiffusion, noised, observations, step: int) -> np.ndarray:
    angles = step * 10_000.0 ** (-np.arange(16) / 15)
    embedding = np.tile(np.concatenate([np.sin(angles), np.cos(angles)]), (len(noised), 1))
    return networks.mlp(model.network, np.concatenate([noised, observations, embedding], axis=1))


@pytest.mark.parametrize("steps", [4, 10])
def test_the_schedule_is_the_squared_cosine(steps):
    schedule = squared_cosine(steps)
    np.testing.assert_allclose(schedule.kept, _kept(steps), rtol=1e-9)
    assert np.all(np.diff(schedule.kept) < 0) and schedule.kept[0] > 0.8
    np.testing.assert_allclose(schedule.std[0], 0.0, atol=1e-12)


def test_the_loss_is_the_squared_error_of_the_noise():
    with tiny.exactly():
        model, batch = _model(), tiny.batch()
        step = np.array([0, 1, 2, 3, 3, 0])
        noise = np.random.default_rng(4).normal(size=(tiny.ROWS, tiny.ACT_DIM))
        found = jax.jit(lambda *given: model.misfit(*given))(
            batch.observations, batch.actions, jnp.asarray(step), tiny.floats(noise)
        )
        for row in range(tiny.ROWS):
            kept = _kept(STEPS)[step[row]]
            noised = np.sqrt(kept) * networks.numbers(batch.actions)[row] + np.sqrt(1 - kept) * noise[row]
            said = _noise_in(model, noised[None], networks.numbers(batch.observations)[[row]], step[row])[0]
            np.testing.assert_allclose(found[row], np.mean((said - noise[row]) ** 2), rtol=1e-9)


def test_sampling_draws_from_the_posterior_of_each_step():
    """q(a_{k-1} | a_k, a^) by Bayes' rule: what a^ foretells of a_{k-1}, times the likelihood of a_k."""
    with tiny.exactly():
        model, observations = _model(), tiny.batch().observations
        noise = np.random.default_rng(5).normal(size=(STEPS, tiny.ROWS, tiny.ACT_DIM))
        found = jax.jit(lambda *given: model.sample(*given))(observations, tiny.floats(noise))
        kept, seen, clipped = _kept(STEPS), networks.numbers(observations), 0
        beta = 1.0 - kept / np.append(1.0, kept[:-1])
        action = noise[0]
        for step in range(STEPS - 1, -1, -1):
            said = _noise_in(model, action, seen, step)
            estimate = (action - np.sqrt(1 - kept[step]) * said) / np.sqrt(kept[step])
            clipped += np.sum(np.abs(estimate) > 1)
            estimate = np.clip(estimate, -1, 1)
            if step == 0:
                action = estimate
                break
            before = kept[step - 1]
            precision = 1 / (1 - before) + (1 - beta[step]) / beta[step]
            mean = np.sqrt(before) * estimate / (1 - before) + np.sqrt(1 - beta[step]) * action / beta[step]
            action = mean / precision + noise[STEPS - step] / np.sqrt(precision)
    assert 0 < clipped < STEPS * tiny.ROWS * tiny.ACT_DIM, "some estimates are cut and some are not"
    np.testing.assert_allclose(found, action, rtol=1e-8, atol=1e-10)


def _two_ways(rows: int = 400) -> Dataset:
    """One state, in which the log does either of two things; the last quarter of its episodes does only the first."""
    rng = np.random.default_rng(0)
    episode = np.arange(rows) // 10
    actions = np.where((rng.random(rows) < 0.5) | (episode >= 30), 0.6, -0.6) + 0.05 * rng.normal(size=rows)
    ends = np.arange(rows) % 10 == 9
    return Dataset.from_arrays(
        rng.normal(size=(rows, 1)),
        actions[:, None],
        (episode >= 30).astype(float),
        next_observations=rng.normal(size=(rows, 1)),
        truncated=ends,
        action_bounds=(-1.0, 1.0),
    )


def _drawn(view: View) -> tuple[np.ndarray, dict]:
    dataset = _two_ways()
    config = DiffusionConfig(hidden_sizes=(32, 32), steps=1_000, batch_size=128, learning_rate=5e-3)
    normaliser = Normaliser.fit(dataset.observations)
    model, report = fit_action_diffusion(config, dataset, normaliser, view, jr.key(0), lambda *_: None)
    noise = jr.normal(jr.key(1), (10, 500, 1))
    return np.asarray(model.sample(jnp.zeros((500, 1)), noise))[:, 0], report


def test_two_ways_to_act_are_learnt_as_two_and_rows_by_weight():
    actions, report = _drawn(View())
    near = np.abs(np.abs(actions) - 0.6) < 0.25
    assert near.mean() > 0.9, "a single Gaussian would put 40 % between the two"
    assert 0.2 < np.mean(actions < 0) < 0.6, "the log does the second in three rows of eight"
    assert report["holdout_error"] < 0.6 and report["warnings"] == []
    actions, _ = _drawn(View(choice=RowChoice(sampling="return", return_temperature=0.1)))
    assert np.mean(actions < 0) < 0.1, "the episodes that pay do only the first"


def test_rows_by_weight_are_as_many_as_their_weights_say():
    rows, weights = np.array([3, 5, 7, 9]), np.array([0.5, 0.0, 2.0, 1.5])
    found = diffusion_fit._by_weight(rows, weights, jr.key(0))
    assert len(found) == 4 and set(found) <= {3, 7, 9}
    assert np.sum(found == 7) == 2 and np.sum(found == 9) in (1, 2)


@pytest.mark.parametrize(
    ("field", "value"), [("diffusion_steps", 0), ("holdout", 1.0), ("hidden_sizes", ()), ("weight_decay", -1.0)]
)
def test_impossible_settings_are_named(field, value):
    with pytest.raises(ConfigError, match=f"behaviour.{field}"):
        DiffusionConfig(**{field: value})
