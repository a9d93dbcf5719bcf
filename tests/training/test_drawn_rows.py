"""Runs whose rows are not drawn all alike: what they record, refuse, and that they are gone on with to the bit."""

import dataclasses

import jax
import numpy as np
import pytest

import odaf
from battery import learners
from golden import tiny as golden
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.algorithms.td3_bc import TD3BC
from odaf.data.start_values import start_values
from odaf.errors import ConfigError
from odaf.runs.many import Plan, fit_many
from odaf.training.drawn_rows import drawn_rows, in_words

SETTINGS = {"stretch": 2, "checkpoint_every": 2, "progress": False}
SMALL = {"hidden_sizes": (4,), "batch_size": 2}


@pytest.fixture(scope="module")
def dataset():
    return learners.log(episodes=8)


@pytest.mark.parametrize(
    "choice",
    [
        {"sampling": "return", "return_temperature": 0.5},
        {"sampling": "advantage", "return_temperature": 0.5},
        {"sampling": "best", "best_share": 0.4},
    ],
)
def test_a_run_records_its_rows_and_is_gone_on_with_to_the_bit(dataset, tmp_path, choice):
    learner = BehaviourCloning(**SMALL, **choice)
    whole = odaf.fit(learner, dataset, steps=4, directory=tmp_path / "whole", **SETTINGS)
    odaf.fit(learner, dataset, steps=2, directory=tmp_path / "cut", **SETTINGS)
    cut = odaf.resume(tmp_path / "cut", steps=4, dataset=dataset, progress=False)
    golden.assert_same_bits(whole.files.state(0), cut.files.state(0))
    drawn, returns = whole.files.data["drawn"], dataset.episode_returns()
    if choice["sampling"] == "best":  # 0.4 of 64 rows: four episodes of 8
        best = float(np.sort(returns)[-4])
        assert drawn == {
            "sampling": "best", "episodes": 4, "rows": 32, "effective_rows": 32.0, "log_rows": 64,
            "lowest_return": pytest.approx(best),
        }  # fmt: skip
    elif choice["sampling"] == "advantage":
        value = start_values(returns, dataset.observations[dataset.episode_starts])
        assert 0.0 <= drawn["explained_by_start"] == value.explained < 1.0
        merits = returns - value.values
        weights = np.exp((merits - merits.max()) / np.ptp(merits) / 0.5)
        assert drawn["effective_rows"] == pytest.approx(8 * weights.sum() ** 2 / np.square(weights).sum())
        assert drawn["rows"] == 64 and drawn["sampling"] == "advantage"
    else:
        weights = np.exp((returns - returns.max()) / (returns.max() - returns.min()) / 0.5)
        effective = 8 * weights.sum() ** 2 / np.square(weights).sum()
        assert drawn["rows"] == drawn["log_rows"] == 64
        assert drawn["effective_rows"] == pytest.approx(effective) and 20 < effective < 64


def test_a_run_of_rows_all_alike_records_nothing_more(dataset, tmp_path):
    run = odaf.fit(BehaviourCloning(**SMALL), dataset, steps=2, directory=tmp_path / "run", **SETTINGS)
    assert "drawn" not in run.files.data


@pytest.mark.parametrize(
    ("choice", "match"),
    [
        (
            {"sampling": "best"},
            r"best_share=0.1 of the rows: .* 8 effective rows of 64, fewer than 10 batches of 2; raise",
        ),
        ({"sampling": "return", "return_temperature": 1e-3}, "return_temperature=0.001: .* 8 effective rows of 64"),
        (
            {"sampling": "advantage", "return_temperature": 1e-3},
            "sampling='advantage', return_temperature=0.001: .* 8 effective rows of 64",
        ),
        ({"sampling": "best", "critic_sampling": "uniform"}, "behaviour-cloning learns all it learns from one batch"),
    ],
)
def test_too_few_rows_are_refused_before_a_directory_is_claimed(dataset, tmp_path, choice, match):
    with pytest.raises(ConfigError, match=match):
        odaf.fit(BehaviourCloning(**SMALL, **choice), dataset, steps=2, directory=tmp_path / "run", **SETTINGS)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("sampling", ["return", "best"])
def test_lanes_with_numbers_of_their_own_are_their_runs_alone(dataset, tmp_path, sampling):
    learner = BehaviourCloning(**SMALL, sampling=sampling, return_temperature=0.5, best_share=0.4)
    other = dataclasses.replace(learner, return_temperature=1.0, best_share=0.6)
    runs = [Plan(each, dataset, tmp_path / str(place)) for place, each in enumerate((learner, other))]
    done = fit_many(runs, lanes=2, steps=4, **SETTINGS)
    for plan, run in zip(runs, done, strict=True):
        alone = odaf.fit(
            plan.algorithm, dataset, steps=4, directory=tmp_path / f"{plan.directory.name}-alone", **SETTINGS
        )
        assert run.files.data["drawn"] == alone.files.data["drawn"]
        pairs = zip(*(jax.tree.leaves(each.files.state(0).actor.now) for each in (run, alone)), strict=True)
        for ours, theirs in pairs:
            np.testing.assert_allclose(ours, theirs, rtol=1e-5, atol=1e-7)


def test_critics_beside_are_recorded_and_every_choice_is_told_in_words(dataset):
    def told(**choice):
        found = drawn_rows(TD3BC(**SMALL, **choice), dataset)["drawn"]
        return found, in_words(found)

    best, words = told(sampling="best", best_share=0.4, critic_sampling="uniform")
    assert (best["rows"], best["log_rows"], best["effective_rows"]) == (32, 64, 32.0)
    assert best["critic_sampling"] == "uniform"
    assert words.startswith("the actor's batches are drawn from the 32 rows of the 4 best episodes (return at least")
    assert words.endswith("; those of the critics from all rows alike")
    found, words = told(sampling="best", best_share=0.4, return_per="step")
    assert found["return_per"] == "step" and "episodes (return per step at least" in words
    assert found["lowest_return"] == pytest.approx(np.sort(dataset.episode_returns() / 8)[-4])
    found, words = told(sampling="advantage", return_temperature=0.5)
    assert words.startswith("batches are drawn by return ") and words.endswith(" rows of 64")
    assert "critic_sampling" not in found
    assert "less what its start foretells (37% of the variance)" in in_words(found | {"explained_by_start": 0.37})
    assert "by return (its start foretells none): as" in in_words(found | {"explained_by_start": 0.0})
