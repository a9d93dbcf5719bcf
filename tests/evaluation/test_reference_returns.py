"""Normalised scores of the locomotion tasks."""

import pytest

from odaf.environments.reference_returns import REFERENCES, normalised_score, reference_of


@pytest.mark.parametrize(
    ("environment", "raw", "score"),
    # Mean returns of published sets and the scores published for them.
    [("HalfCheetah-v4", 4770.33, 40.68), ("Hopper-v5", 3511.36, 108.51), ("Walker2d-v4", 682.70, 14.84)],
)
def test_published_returns_give_published_scores(environment, raw, score):
    found = normalised_score(environment, [raw - 1.0, raw + 1.0])
    assert found is not None
    assert found["normalised_score"] == pytest.approx(score, abs=0.006)
    assert found["mean_return"] == pytest.approx(raw) and found["environment"] == environment


def test_raw_inverts_normalise():
    for reference in REFERENCES.values():
        assert reference.normalise(reference.random) == 0.0 and reference.normalise(reference.expert) == 100.0
        assert reference.raw(reference.normalise(1234.5)) == pytest.approx(1234.5)


@pytest.mark.parametrize("environment", ["Ant-v4", "Hopper", "hopper-v4", "Hopper-v4x", "pointmaze"])
def test_without_a_reference_there_is_no_score(environment):
    assert reference_of(environment) is None and normalised_score(environment, [1.0]) is None
