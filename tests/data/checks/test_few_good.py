"""Whether a few episodes are far better than the rest: which, by what they were compared, and when nothing is said."""

from typing import Any

import numpy as np
import pytest

from odaf.data.checks import Finding
from odaf.data.checks.returns import Returns
from odaf.data.checks.stream import blocks
from odaf.data.checks.structure import examine
from odaf.data.log import Log


def found(returns, lengths, terminated: Any = False, block: int = 10_000) -> Finding | None:
    """What the check says of episodes with these returns and lengths."""
    lengths = np.broadcast_to(lengths, len(returns))
    rows = int(lengths.sum())
    last = np.isin(np.arange(rows), np.cumsum(lengths) - 1)
    ended = np.repeat(np.broadcast_to(terminated, len(returns)), lengths)
    columns = {
        "observations": np.zeros((rows, 1)),
        "actions": np.zeros((rows, 1)),
        "rewards": np.repeat(np.divide(returns, lengths), lengths),
        "terminated": last & ended,
        "truncated": last & ~ended,
    }
    facts, _ = examine(Log(columns, "log.csv", "csv", action_bounds=(-1.0, 1.0)), None)
    assert facts is not None
    check = Returns(facts)
    for part in blocks(facts, block):
        check.see(part)
    advice = [finding for finding in check.findings() if finding.check == "few-good-episodes"]
    return advice[0] if advice else None


def normal(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(10.0, 1.0, count)


@pytest.mark.parametrize("block", [10_000, 7])
def test_the_few_are_counted_named_and_set_against_the_rest(block):
    returns = normal(60)
    good = [7, 20, 21, 59]
    returns[good] = [40.0, 50.0, 45.0, 90.0]
    advice = found(returns, 10, block=block)
    assert advice is not None and advice.severity == "note" and advice.count == 4
    assert advice.rows == (70, 200, 210, 590)
    rest = np.delete(returns, good)
    assert "4 of 60 episodes, 6.7% of the rows, have a return of at least 40;" in advice.message
    assert (
        f"have {rest.mean():.4g} on average, with a spread of {rest.std():.2g} (compared by return, " in advice.message
    )
    assert "sampling='return'" in advice.remedy and "return_per" not in advice.remedy


def test_rare_successes_among_returns_of_nothing_are_found():
    returns = np.zeros(50)
    returns[[3, 4, 40]] = 1.0
    advice = found(returns, 30, terminated=returns > 0)
    assert advice is not None and advice.count == 3 and "return of at least 1;" in advice.message


@pytest.mark.parametrize(
    "returns",
    [
        normal(500),
        np.zeros(50),
        np.append(normal(59), 60.0),  # one good episode is no part of a log
        np.append(normal(40), 60.0 + normal(20)),  # a third is not a few
        -np.append(normal(57), [40.0, 50.0, 45.0]),  # a few far worse
        np.append(normal(12), [40.0, 50.0, 45.0]),  # too few to compare
    ],
    ids=["normal", "nothing", "one", "third", "worse", "fifteen"],
)
def test_logs_of_another_kind_are_left_alone(returns):
    assert found(returns, 10) is None


def test_a_fragment_of_costs_is_not_among_the_good():
    """Costs of ten a whole episode; three that the recording cut after two of fifty rows cost nearly nothing."""
    costs, lengths = -normal(60), np.full(60, 50)
    lengths[:3], costs[:3] = 2, -0.1
    assert found(costs, lengths) is None
    costs[[10, 11, 12]] = -0.5
    advice = found(costs, lengths)
    assert advice is not None and advice.count == 3 and "of 57 episodes" in advice.message


def test_episodes_cut_at_different_lengths_are_compared_per_step():
    """Each row earns 1, and 3 in four episodes; returns alone follow the lengths, from 60 to 119 rows."""
    lengths = 60 + np.arange(60)
    per_row = 1.0 + 0.05 * (normal(60) - 10.0)
    per_row[[2, 30, 31, 50]] = 3.0
    advice = found(per_row * lengths, lengths)
    assert advice is not None and advice.count == 4
    assert "have a return per step of at least 3;" in advice.message
    assert "compared by return per step, as the recording cut episodes of different length" in advice.message
    assert "return_per='step'" in advice.remedy


def test_lengths_that_failure_decided_are_part_of_the_merit():
    """Each row earns 1 until the fall: the return says it, the return per step does not."""
    lengths = np.full(60, 20)
    lengths[[5, 6, 7]] = 200
    assert found(lengths.astype(float), lengths, terminated=True) is None  # they hold a third of the rows
    lengths[[5, 6, 7]] = 80
    advice = found(lengths.astype(float), lengths, terminated=True)
    assert advice is not None and advice.count == 3 and "return of at least 80;" in advice.message
