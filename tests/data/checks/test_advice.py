"""Which method a log asks for: made logs of each kind, what must not change the answer, and what stands behind it."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import odaf
from data.checks import healthy
from odaf.data.checks import Advice, check_log
from odaf.data.checks.advice import CASES, advice_for
from odaf.data.checks.log_statistics import measure
from odaf.data.checks.parting import equal, part
from odaf.data.checks.sample import Sample
from odaf.errors import DatasetError
from odaf.runs import presets
from odaf.training.drawn_rows import drawn_rows

ROOT = Path(__file__).parents[3]


def made(
    returns: Any, lengths: Any, *, ended: Any = False, columns: int = 11, noise: float = 1.0, **changes: Any
) -> dict[str, Any]:
    """Rows of episodes with these returns and lengths; `noise` is the spread of rewards within an episode."""
    rng = np.random.default_rng(0)
    returns = np.asarray(returns, float)
    lengths = np.broadcast_to(lengths, len(returns)).astype(int)
    rows, of = int(lengths.sum()), np.repeat(np.arange(len(returns)), lengths)
    off = rng.normal(0.0, noise, rows)
    off -= (np.bincount(of, off) / lengths)[of]
    found = {
        "rewards": (returns / lengths)[of] + off,
        "of": of,
        "ended": np.broadcast_to(ended, len(returns)),
        "observations": rng.normal(size=(rows, columns)),
        "actions": rng.uniform(-0.9, 0.9, (rows, 2)),
        "mixed": False,
    }
    return found | {name: change(found) if callable(change) else change for name, change in changes.items()}


def advice_of(log: dict[str, Any]) -> Advice:
    rewards, of = log["rewards"], log["of"]
    lengths = np.bincount(of)
    firsts = np.cumsum(lengths) - lengths
    sample = Sample(log["observations"], log["actions"], rewards, None, np.arange(len(of)), of, of, len(of))
    episodes = np.stack([firsts, np.bincount(of, rewards), lengths, log["ended"]]).astype(float)
    names = tuple(f"observation_{place}" for place in range(log["observations"].shape[1]))
    return advice_for(measure(episodes, float(rewards.var()), len(of), names, 2, sample, log["mixed"]))


def normal(mean: float, spread: float, count: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(mean, spread, count)


def poor(good: int, length: int = 500) -> dict[str, Any]:
    """Four hundred falls after twenty rows, and a few long episodes."""
    returns = np.append(normal(20.0, 3.0, 400), normal(3_500.0, 20.0, good))
    lengths = np.append(np.full(400, 20), np.full(good, length))
    return made(returns, lengths, ended=lengths == 20)


def halves(**settings: Any) -> dict[str, Any]:
    return made(np.append(normal(70.0, 2.0, 60), normal(20.0, 5.0, 60)), 100, **settings)


ALIKE = normal(100.0, 5.0, 120)
GOALS = normal(0.0, 1.0, 120, seed=3)
LOGS = {
    "few-far-better": lambda: poor(4),
    "whole-ways": lambda: halves(columns=4),
    "better-half": lambda: halves(),
    "alike": lambda: made(ALIKE, 100),
    "alike-and-falling": lambda: made(ALIKE * (1 + np.arange(120) % 5 / 50), 100 + np.arange(120) % 5, ended=True),
    "small-plant": lambda: made(ALIKE, 100, columns=4),
    "broad": lambda: made(np.linspace(0.0, 1_000.0, 120), 100),
    "few-rows": lambda: made(ALIKE, 20),
    "few-episodes": lambda: made([7.0], 12_000),
    "no-difference": lambda: made(np.full(120, 5.0), 100, noise=0.0, rewards=lambda log: np.full(len(log["of"]), 0.05)),
    "goals": lambda: made(
        ALIKE, 100, observations=lambda log: np.column_stack([log["observations"], GOALS[log["of"]]])
    ),
    "starts": lambda: made(
        ALIKE, 100, observations=lambda log: log["observations"] + (ALIKE - 100.0)[log["of"], None]
    ),
    "one-answer": lambda: made(ALIKE, 100, actions=lambda log: log["observations"][:, :2] * [0.2, -0.1]),
    "sparse": lambda: made(
        ALIKE, 100, rewards=lambda log: 1.0 * ((np.arange(len(log["of"])) % 100 == 99) & (log["of"] % 2 == 0))
    ),
    "mixed-per-batch": lambda: poor(4) | {"mixed": True},
}  # fmt: skip


def test_there_is_a_log_for_every_case():
    assert set(LOGS) == {case.name for case in CASES}


@pytest.mark.parametrize("case", LOGS)
def test_each_kind_of_log_gets_its_advice_in_any_unit(case: str):
    log = LOGS[case]()
    advice = advice_of(log)
    assert advice.case == case
    for change in (lambda rewards: 1_000.0 * rewards, lambda rewards: 1e-4 * rewards):
        other = advice_of(log | {"rewards": change(log["rewards"])})
        assert (other.case, other.settings) == (case, advice.settings)


@pytest.mark.parametrize("case", [case for case in LOGS if case not in ("few-far-better", "mixed-per-batch")])
@pytest.mark.parametrize("constant", [7.0, -300.0])
def test_what_every_row_earns_beside_changes_nothing_where_episodes_are_equally_long(case: str, constant: float):
    log = LOGS[case]()
    if case == "alike-and-falling":
        log = made(ALIKE, 100, ended=True)
    advice, other = advice_of(log), advice_of(log | {"rewards": log["rewards"] + constant})
    assert advice.case == case
    assert (other.case, other.settings) == (case, advice.settings)


@pytest.mark.parametrize(
    ("returns", "lengths", "settings"),
    [
        (
            [10.0] * 3,
            1_000,
            {},
        ),  # of 11,000 rows 3,000 are good: more than a few, so all that counts is their best tenth
        ([10.0] * 3, 150, {"best_share": 0.053, "batch_size": 16, "hidden_sizes": [64, 64]}),
    ],
)
def test_no_more_is_called_the_best_than_is_good(returns, lengths, settings):
    """Four hundred episodes of twenty rows that earn about nothing, and three good ones."""
    sizes = np.append(np.full(400, 20), np.full(3, lengths))
    log = made(np.append(normal(0.0, 1.0, 400), np.multiply(returns, 100.0)), sizes, ended=True)
    advice = advice_of(log)
    assert advice.preset == "behaviour-cloning-best"
    if settings:
        assert advice.case == "few-far-better" and advice.settings == settings
    else:
        assert advice.case == "better-half" and "best_share" not in advice.settings


def test_a_fifth_and_a_little_more_is_still_a_few():
    advice = advice_of(poor(4, length=510))
    assert advice.statistics.good_rows > 0.2 and advice.case == "few-far-better"


def test_a_row_is_compared_where_the_recorder_decided_how_long_an_episode_is():
    lengths = 60 + np.arange(60)
    per_row = 1.0 + 0.05 * normal(0.0, 1.0, 60)
    per_row[[2, 30, 31, 50]] = 3.0
    advice = advice_of(made(per_row * lengths, lengths, noise=0.01))
    assert advice.case == "few-far-better" and advice.settings["return_per"] == "step"
    assert "return per step of at least 3" in advice.why


def test_what_only_rounding_tells_apart_is_equal():
    """The order in which rewards are summed lifts three of fifty equal returns by one bit."""
    merits = np.full(50, 3.3)
    merits[[1, 20, 30]] = np.nextafter(3.3, 4.0)
    assert equal(merits) and part(merits, np.full(50, 100)) is None
    merits[[1, 20, 30]] = 3.3001
    assert not equal(merits) and part(merits, np.full(50, 100)) is not None


@pytest.mark.parametrize("rows", [500, 1_500, 5_000, 30_000])
@pytest.mark.parametrize("case", ["few-far-better", "broad"])
def test_what_is_advised_is_not_refused_for_too_few_rows(case: str, rows: int):
    """At every size the learner that is advised finds ten batches to draw from."""
    episodes = max(rows // 100, 20)
    returns = np.linspace(0.0, 1_000.0, episodes)
    if case == "few-far-better":
        returns = normal(0.0, 1.0, episodes)
        returns[:: episodes // 4] = 100.0
    log = made(returns, rows // episodes, noise=0.1)
    advice = advice_of(log)
    assert advice.case in (case, "few-rows", "better-half")
    last = np.append(np.diff(log["of"]) > 0, True)
    dataset = odaf.Dataset.from_arrays(
        log["observations"], log["actions"], log["rewards"], log["observations"], truncated=last,
        action_bounds=(-1.0, 1.0),
    )  # fmt: skip
    drawn_rows(odaf.preset(advice.preset, **advice.settings), dataset)  # raises where rows are too few


def test_the_advice_names_its_reasons_in_the_logs_numbers():
    advice = advice_of(poor(4))
    assert advice.words == "behaviour-cloning-best --batch-size 64"
    assert advice.command("my log.h5", "run") == (
        "odaf train behaviour-cloning-best --batch-size 64 --data 'my log.h5' --out run"
    )
    assert "4 of 404 episodes, 20.0% of the rows, have a return of at least 34" in advice.why
    text = str(advice)
    assert "behaviour-cloning (the bar to pass), rebrac-return --averaged-updates 5000" in text
    assert "train `odaf` too" in text and max(map(len, text.splitlines())) <= 110
    json.dumps(advice.to_dict(), allow_nan=False)
    assert advice.to_dict()["statistics"]["good_episodes"] == 4


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_what_is_advised_and_what_stands_beside_it_exists(case):
    known = presets.names()
    assert case.preset in known
    assert {words.split()[0] for words in case.beside} <= set(known)


def test_measured_numbers_are_those_of_the_records():
    methods = json.loads((ROOT / "results/rivals/summary.json").read_text())["hopper-mixture-80"]["methods"]

    def seeds(method: str) -> str:
        scores = methods[method]["by_seed"].values()
        return f"{min(scores):.0f} to {max(scores):.0f}"

    support = {case.name: case.support for case in CASES}
    assert f"{seeds('behaviour-cloning-best')} by seed" in support["few-far-better"]
    assert seeds("rebrac-return-averaged_updates-5000") in support["few-far-better"]
    assert seeds("behaviour-cloning") == "2 to 2" and "cloning all rows 2:" in support["few-far-better"]
    assert f"earned {seeds('td3-bc-sampling-return')} by seed" in support["broad"]
    assert f"{seeds('td3-bc')} on rows drawn alike" in support["broad"]


def test_a_report_ends_with_advice_and_one_with_errors_has_none(tmp_path: Path):
    report = check_log(healthy.log())
    assert report.advice.case == "few-rows" and report.to_dict()["advice"]["preset"] == "behaviour-cloning"
    spoiled = healthy.columns()["rewards"]
    spoiled[4] = np.nan
    assert check_log(healthy.log({"rewards": spoiled})).advice is None
    outside = check_log(healthy.log({"actions": 3.0 * healthy.columns()["actions"]}))  # an error, and all is finite
    assert not outside.usable and outside.advice is None
    log = odaf.Dataset.from_log(healthy.log())
    log.save(tmp_path / "log.h5")
    assert odaf.advise(log) == odaf.advise(tmp_path / "log.h5")
    assert odaf.advise(log).settings == report.advice.settings
    with pytest.raises(DatasetError, match="the checks find errors .first: unreadable: .*without mending them"):
        odaf.advise(tmp_path / "no.h5")
