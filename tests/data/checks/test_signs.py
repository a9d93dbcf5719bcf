"""Signs that a log cannot teach what is asked: which rows, columns and actions they name, and what they leave alone."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from data.checks import healthy
from odaf.data.checks import Finding, Report, check_log
from odaf.data.checks.sample import ROWS, Sampler
from odaf.data.checks.signs.lonely_episodes import _apart_from
from odaf.data.checks.stream import blocks
from odaf.data.checks.structure import examine
from odaf.data.log import Log

EPISODES, STEPS = 40, 100


def plant(delay: int = 0, gain: float = 0.3, columns: int = 2, seed: int = 3, noise: float = 0.05) -> dict[str, Any]:
    """A cart that is pushed at random: position and speed, thirty more actions than are needed to see what they do."""
    rng = np.random.default_rng(seed)
    actions = rng.uniform(-1, 1, (EPISODES, STEPS, columns))
    states = rng.normal(size=(EPISODES, 2))
    seen = []
    for step in range(STEPS):
        seen.append(states)
        push = actions[:, step - delay].sum(axis=1) if step >= delay else np.zeros(EPISODES)
        speed = 0.9 * states[:, 1] + gain * push + noise * rng.normal(size=EPISODES)
        states = np.stack([0.95 * states[:, 0] + 0.1 * speed, speed], axis=1)
    observations = np.stack(seen, axis=1).reshape(-1, 2)
    return {
        "observations": observations,
        "actions": actions.reshape(-1, columns),
        "rewards": -np.square(observations).sum(axis=1) + rng.normal(size=EPISODES * STEPS),
        "episode": np.repeat(np.arange(EPISODES), STEPS),
    }


def report_on(columns: dict[str, Any], **settings: Any) -> Report:
    names = {"observation_names": tuple(f"x{index}" for index in range(columns["observations"].shape[1]))}
    own = {"action_bounds": (-1.0, 1.0), **names, **settings}
    return check_log(Log(columns, "log.csv", "csv", **own))


def only(report: Report, check: str) -> Finding:
    (finding,) = [finding for finding in report.findings if finding.check == check]
    return finding


def warnings(report: Report) -> set[str]:
    return {finding.check for finding in report.of("warning")}


def test_a_sound_plant_shows_none():
    assert warnings(report_on(plant())) == set()


# ---- columns that hold the action ----------------------------------------------------------------------------------


def with_column(columns: dict[str, Any], column: np.ndarray) -> dict[str, Any]:
    return {**columns, "observations": np.column_stack([columns["observations"], column])}


def shifted(columns: dict[str, Any], by: int) -> np.ndarray:
    """The second action of `by` rows later, by episode; the last ones are repeated."""
    actions = columns["actions"][:, 1].reshape(EPISODES, STEPS)
    place = np.clip(np.arange(STEPS) + by, 0, STEPS - 1)
    return actions[:, place].ravel()


@pytest.mark.parametrize(("by", "which", "row"), [(0, "its own", 2), (1, "the next", 2)])
def test_a_column_that_holds_the_action(by: int, which: str, row: int):
    columns = plant()
    finding = only(report_on(with_column(columns, 50 * (1 + shifted(columns, by)))), "action-in-observations")
    assert finding.severity == "warning"
    assert f"x2 already holds the action action_1 of {which} row" in finding.message
    assert finding.rows[0] == row
    assert "leave x2 out" in finding.remedy


@pytest.mark.parametrize("by", [-1, -2])
def test_actions_that_were_taken_may_be_seen(by: int):
    columns = plant()
    assert warnings(report_on(with_column(columns, shifted(columns, by)))) == set()


def test_a_controller_in_proportion_to_one_column_holds_no_action():
    """Every action follows from the column, by a gain that is no change of unit."""
    columns = plant(columns=1)
    columns["actions"] = -0.37 * columns["observations"][:, 1:]
    found = warnings(report_on(columns))
    assert "action-in-observations" not in found


def test_a_switch_that_is_echoed_a_row_later_holds_no_action():
    """On and off for twenty rows each: nearly all rows of the echo equal the action of their own row."""
    columns = plant(columns=1)
    switch = np.where(np.arange(STEPS) // 20 % 2, 1.0, -1.0)
    columns["actions"] = np.tile(switch, EPISODES)[:, None]
    late = np.tile(np.append(switch[0], switch[:-1]), EPISODES)
    assert "action-in-observations" not in warnings(report_on(with_column(columns, late)))
    own = only(report_on(with_column(columns, columns["actions"][:, 0])), "action-in-observations")
    assert own.rows == (20, 40, 60, 80, 120)


# ---- rewards -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda c: 3 * c["observations"][:, 1] + 1, "is a straight line in column x1 alone"),
        (lambda c: -np.abs(c["observations"][:, 0] - 0.2), "can be computed from column x0 alone"),
        (lambda c: c["actions"][:, 0] ** 2, "can be computed from action action_0 alone"),
    ],
)
def test_a_reward_that_one_column_says(make: Any, says: str):
    columns = plant()
    columns["rewards"] = make(columns)
    finding = only(report_on(columns), "reward-from-one-column")
    assert says in finding.message
    assert finding.rows[:3] == (0, 1, 2)


def test_a_reward_of_the_next_observation_is_seen_too():
    columns = plant()
    following = np.roll(columns["observations"], -1, axis=0)
    following[STEPS - 1 :: STEPS] = columns["observations"][STEPS - 1 :: STEPS]
    columns |= {"next_observations": following, "rewards": np.sin(following[:, 0])}
    assert "from the next x0 alone" in only(report_on(columns), "reward-from-one-column").message


def test_a_reward_and_a_column_that_both_only_go_on_say_nothing_of_each_other():
    """A clock over the whole log and a reward that changes slowly: neighbours in one are neighbours in the other."""
    columns = plant()
    hours = np.arange(EPISODES * STEPS) / 60
    columns["rewards"] = np.sin(hours / 2) + np.sin(hours / 5)
    assert warnings(report_on(with_column(columns, hours))) == set()


# ---- dead time and actions without effect --------------------------------------------------------------------------


@pytest.mark.parametrize("delay", [1, 3])
def test_dead_time(delay: int):
    finding = only(report_on(plant(delay=delay)), "dead-time")
    assert f"action_0 after {delay}, action_1 after {delay}" in finding.message
    assert finding.remedy == f"put the last actions among the observations: --lags {delay} of `odaf data import`"
    assert finding.rows[0] == 2


def test_dead_time_is_no_fault_where_the_remedy_was_taken():
    columns = plant(delay=2)
    for column in (0, 1):
        actions = columns["actions"][:, column].reshape(EPISODES, STEPS)
        for lag in (1, 2):
            earlier = actions[:, np.maximum(np.arange(STEPS) - lag, 0)].ravel()
            columns = with_column(columns, earlier)
    assert warnings(report_on(columns)) == set()


def test_actions_that_change_nothing():
    finding = only(report_on(plant(gain=0.0)), "no-effect")
    assert "depends on action_0, action_1, neither at once nor within" in finding.message
    columns = plant(columns=2)
    columns["actions"][:, 1] = np.random.default_rng(1).uniform(-1, 1, EPISODES * STEPS)
    finding = only(report_on(columns), "no-effect")
    assert "depends on action_1, neither" in finding.message


def test_what_follows_from_the_state_alone_is_not_said_to_have_no_effect():
    """Nothing was tried: no log could show what the action does."""
    columns = plant(columns=1)
    columns["actions"] = np.clip(-0.3 * columns["observations"][:, :1] - 0.1 * columns["observations"][:, 1:], -1, 1)
    assert "no-effect" not in warnings(report_on(columns))


def test_an_effect_by_products_alone_is_one():
    """The action only strengthens or weakens what goes on anyway, so that on average it changes nothing."""
    rng = np.random.default_rng(0)
    columns = plant(columns=1)
    states, seen = rng.normal(size=(EPISODES, 2)), []
    for step in range(STEPS):
        seen.append(states)
        pushed = columns["actions"].reshape(EPISODES, STEPS)[:, step]
        states = 0.5 * states + 0.4 * pushed[:, None] * states + 0.5 * rng.normal(size=(EPISODES, 2))
    columns["observations"] = np.stack(seen, axis=1).reshape(-1, 2)
    assert warnings(report_on(columns)) == set()


# ---- episodes that do not fit together -----------------------------------------------------------------------------


def test_two_controllers_that_contradict_each_other():
    columns = plant(columns=1)
    turned = np.isin(columns["episode"], [3, 8, 20, 21, 30, 31])
    rule = np.tanh(columns["observations"][:, :1]) + 0.1 * columns["actions"]
    columns["actions"] = np.where(turned[:, None], -rule, rule) / 1.2
    finding = only(report_on(columns), "controllers-conflict")
    assert finding.count == 6
    assert finding.rows == (300, 800, 2_000, 2_100, 3_000)


def test_an_expert_and_a_beginner_do_not_contradict_each_other():
    columns = plant(columns=1)
    skilled = (columns["episode"] % 2 == 0)[:, None]
    columns["actions"] = np.where(skilled, -0.4 * columns["observations"][:, :1], columns["actions"]).clip(-1, 1)
    assert "controllers-conflict" not in warnings(report_on(columns))


def test_an_episode_where_no_other_went():
    columns = plant()
    away = columns["episode"] == 7
    columns["observations"][away, 0] += 20
    finding = only(report_on(columns), "lonely-episode")
    assert (finding.count, finding.rows) == (1, (700,))
    assert "x0" in finding.message


@pytest.mark.parametrize(("by", "found"), [(0.3, True), (0.05, False)])
def test_an_episode_not_far_away_is_lonely_where_nothing_lies_between(by: float, found: bool):
    """All others stay close together, so less than a spread is far."""
    rng = np.random.default_rng(0)
    columns = plant()
    columns["observations"] = rng.uniform(-1.7, 1.7, columns["observations"].shape)
    away = columns["episode"] == 7
    columns["observations"][away] = 1.7 + 2 * by + 0.1 * rng.uniform(-1, 1, (int(away.sum()), 2))
    assert ("lonely-episode" in warnings(report_on(columns))) == found


def test_where_episodes_stand_apart():
    """From the first gap on, and only if those beyond it are few and not near."""
    crowd = np.linspace(0.01, 0.05, 40)
    assert _apart_from(np.append(crowd, 0.5)) == 0.5
    assert _apart_from(np.append(crowd, [0.5, 0.7, 0.6])) == 0.5
    assert _apart_from(np.append(crowd, 0.2)) == np.inf
    assert _apart_from(np.append(crowd, [0.3, 0.2, 0.1])) == np.inf
    assert _apart_from(np.append(crowd, np.full(10, 0.5))) == np.inf


def test_one_long_episode_is_not_lonely():
    columns = plant()
    columns["episode"] = np.zeros(EPISODES * STEPS, int)
    assert "lonely-episode" not in warnings(report_on(columns))


# ---- the sample ----------------------------------------------------------------------------------------------------


def sample_of(log: Log, rows: int) -> Any:
    facts, _ = examine(log, None)
    assert facts is not None
    sampler = Sampler(facts)
    for block in blocks(facts, rows):
        sampler.see(block)
    return sampler.sample()


@pytest.mark.parametrize("steps", [7, 900, 60_000])
def test_the_sample_is_bounded_and_the_same_for_blocks_of_any_size(steps: int):
    count = 120_000
    rng = np.random.default_rng(0)
    columns = {
        "observations": rng.normal(size=(count, 2)),
        "actions": rng.normal(size=(count, 1)),
        "rewards": rng.normal(size=count),
        "episode": np.arange(count) // steps,
    }
    log = Log(columns, "log", "csv")
    samples = [sample_of(log, rows) for rows in (1_000, 4_999, count)]
    for sample in samples:
        assert 0.9 * ROWS < len(sample) <= ROWS
        np.testing.assert_array_equal(sample.number, samples[0].number)
        np.testing.assert_array_equal(sample.observations, columns["observations"][sample.number])
        np.testing.assert_array_equal(sample.episode, sample.number // steps)
        np.testing.assert_array_equal(np.diff(sample.number)[sample.goes_on[:-1]], 1)
    assert samples[0].share == f" (in a sample of {len(samples[0]):,} of {count:,} rows)"
    assert sample_of(replace(healthy.log()), 500).share == ""
    known = np.isfinite(samples[0].following).all(axis=1)
    np.testing.assert_array_equal(known, samples[0].goes_on)
