"""Runs compared: what is said of each, of every two, and of what makes their scores no like for like."""

import json

import numpy as np
import pytest
from scipy import stats

import odaf
from golden.runs import scored_run
from odaf.errors import ConfigError
from odaf.report.comparison import Comparison
from odaf.report.records import read_run

FIRST = {0: [10.0, 14.0], 1: [12.0, 20.0], 2: [11.0, 13.0]}  # means 12, 16, 12
SECOND = {0: [9.0, 13.0], 1: [11.0, 17.0], 2: [5.0, 13.0]}  # means 11, 14, 9


def test_each_run_has_its_mean_with_an_interval_over_seeds_and_the_middle_of_its_episodes(tmp_path):
    (run,) = odaf.compare([scored_run(tmp_path / "a", FIRST)]).runs
    expected = stats.t.interval(0.95, 2, 40 / 3, stats.sem([12.0, 16.0, 12.0]))
    assert (run.name, run.seeds, run.seed_means) == ("odaf", (0, 1, 2), (12.0, 16.0, 12.0))
    assert run.estimate.mean == pytest.approx(40 / 3)
    assert (run.estimate.low, run.estimate.high) == pytest.approx(expected)
    assert run.interquartile_mean == pytest.approx(np.mean([11, 12, 13, 14]))
    assert (run.episodes, run.steps) == ((2, 2, 2), (100, 100, 100))


def test_seeds_of_the_same_data_are_partners(tmp_path):
    runs = [scored_run(tmp_path / "a", FIRST), scored_run(tmp_path / "b", SECOND, "rorl")]
    found = odaf.compare(runs)
    (pair,) = found.pairs
    expected = stats.ttest_rel([12, 16, 12], [11, 14, 9]).confidence_interval(0.95)
    assert (pair.first, pair.second, pair.difference.statistic) == ("odaf", "rorl", "paired t")
    assert (pair.difference.mean, pair.difference.low) == pytest.approx((2.0, expected.low))
    assert pair.improvement.probability == stats.mannwhitneyu([12, 16, 12], [11, 14, 9]).statistic / 9
    assert found.notes == ()
    assert found.pair("odaf", "rorl") is pair
    with pytest.raises(ConfigError, match="no pair 'rorl', 'odaf'; there are: odaf against rorl"):
        found.pair("rorl", "odaf")


@pytest.mark.parametrize(
    ("returns", "data", "note"),
    [
        ({3: [1.0], 4: [2.0]}, {}, "different numbers of episodes a seed: 2 (odaf); 1 (rorl)"),
        ({0: [1.0, 1.0], 1: [2.0, 2.0]}, {}, ""),
        (SECOND, {"rows_sha256": "ef" * 32}, "different data: ab12ab12ab12 (odaf); efefefefefef (rorl)"),
        (
            SECOND,
            {"environment": {"name": "gymnasium", "id": "Hopper-v4", "kwargs": {}}},
            "played in different environments: Hopper-v5 (odaf); Hopper-v4 (rorl)",
        ),
    ],
    ids=["other seeds", "fewer seeds", "other data", "another environment"],
)
def test_what_has_no_partners_is_compared_as_independent_and_says_why(tmp_path, returns, data, note):
    runs = [scored_run(tmp_path / "a", FIRST), scored_run(tmp_path / "b", returns, "rorl", data=data)]
    found = odaf.compare(runs)
    (pair,) = found.pairs
    means = [np.mean(values) for values in returns.values()]
    expected = stats.ttest_ind([12, 16, 12], means, equal_var=False).confidence_interval(0.95)
    assert pair.difference.statistic == "Welch's t"
    assert (pair.difference.low, pair.difference.high) == pytest.approx((expected.low, expected.high))
    assert note in str(found) and bool(found.notes) == bool(note)
    if "rows_sha256" in data:
        assert odaf.compare(runs, data_free=True).pairs[0].difference.statistic == "paired t"


def test_updates_and_simulators_that_differ_are_named(tmp_path):
    runs = [scored_run(tmp_path / "a", FIRST), scored_run(tmp_path / "b", SECOND, "rorl", step=200)]
    for seed in SECOND:
        path = runs[1] / f"seed-{seed}" / "summary.json"
        summary = json.loads(path.read_text())
        summary["evaluation"]["simulator"] = {"mujoco": "3.3.7", "contact_margins": "larger"}
        path.write_text(json.dumps(summary))
    simulator, updates = odaf.compare(runs).notes
    assert simulator.startswith("these runs were played by different simulators: not known (odaf); MuJoCo 3.3.7")
    assert updates == "these runs had different numbers of updates: 100 (odaf); 200 (rorl)"


def test_seeds_and_episodes_without_a_sound_number_are_left_out_by_name(tmp_path):
    returns = {0: [1.0, None, 3.0], 1: [None, None, None], 2: [], 3: [2.0, 2.0, 2.0]}
    found = odaf.compare([scored_run(tmp_path / "a", returns)])
    assert found.runs[0].seeds == (0, 3) and found.runs[0].seed_means == (2.0, 2.0)
    assert found.notes == (
        "odaf: seeds 1 are left out, for each episode of their last evaluation broke off",
        "odaf: seeds 2 are left out, for they were not evaluated",
        "odaf: 1 of 6 episodes broke off and count in no mean",
    )


def test_a_run_without_any_score_is_refused_with_the_reason(tmp_path):
    with pytest.raises(
        ConfigError, match=r"a: has no score, for each episode of the last evaluation of seeds 0, 1 broke"
    ):
        odaf.compare([scored_run(tmp_path / "a", {0: [None], 1: [None, None]})])
    with pytest.raises(ConfigError, match=r"b: has no score, for no seed was evaluated; train with evaluation"):
        odaf.compare([scored_run(tmp_path / "b", {0: []})])


def test_against_one_run_or_every_two(tmp_path):
    a, b, c = (scored_run(tmp_path / name, SECOND, name) for name in "abc")

    def pairs(found: Comparison):
        return [(pair.first, pair.second) for pair in found.pairs]

    assert pairs(odaf.compare([a, b, c])) == [("a", "b"), ("a", "c"), ("b", "c")]
    assert pairs(odaf.compare([a, b, c], against=b)) == [("a", "b"), ("c", "b")]
    assert pairs(odaf.compare([a, b], against=c, names=["x", "y", "z"])) == [("x", "z"), ("y", "z")]
    assert pairs(odaf.compare([odaf.load_run(a), tmp_path / "b"])) == [("a", "b")]
    assert pairs(odaf.compare([tmp_path])) == [("a", "b"), ("a", "c"), ("b", "c")]
    with pytest.raises(ConfigError, match="holds 3 runs; name one of them"):
        odaf.compare([a], against=tmp_path)
    with pytest.raises(ConfigError, match="1 names for 2 runs"):
        odaf.compare([a, b], names=["x"])


def test_one_seed_and_no_spread_say_so(tmp_path):
    one, two, same = (
        scored_run(tmp_path / name, returns, name)
        for name, returns in (("one", {0: [1.0]}), ("two", {0: [5.0], 1: [5.0]}), ("same", {0: [3.0], 1: [3.0]}))
    )
    lines = str(odaf.compare([one, two, same])).splitlines()
    (alone,) = [line for line in lines if line.startswith("one against two")]
    assert alone.split("  ")[-1].strip() == "cannot be said" and alone.count("one seed") == 2
    (flat,) = [line for line in lines if line.startswith("two against same")]
    assert "+2.00 to +2.00" in flat and flat.endswith("cannot be said, decided")


def test_the_table_says_which_statistic_and_what_is_resampled(tmp_path):
    found = odaf.compare([scored_run(tmp_path / "a", FIRST), scored_run(tmp_path / "b", SECOND, "rorl")])
    text, content = str(found), found.to_dict()
    pair = content["pairs"][0]
    assert "odaf against rorl           +2.0   -0.5 to +4.5   paired t" in text  # differences 1, 2 and 3
    assert f"  {pair['difference']['enough']}\n" in text and pair["difference"]["enough"] == 4
    assert "resamples the seeds of each run" in text and "Student's t interval over the seeds" in text
    assert json.loads(json.dumps(content, allow_nan=False)) == content | {"notes": []}
    assert content["runs"][0]["seed_means"] == [12.0, 16.0, 12.0]
    assert read_run(tmp_path / "a").seeds[0].broken is False


def test_a_run_without_a_score_is_left_out_and_the_others_are_compared(tmp_path):
    runs = [scored_run(tmp_path / "a", FIRST), scored_run(tmp_path / "b", SECOND, "rorl")]
    without = scored_run(tmp_path / "c", {}, "sac-n")
    found = odaf.compare([runs[0], without, runs[1]])
    assert [run.name for run in found.runs] == ["odaf", "rorl"] and len(found.pairs) == 1
    (note,) = found.notes
    assert note.startswith("sac-n is left out: ") and "c: has no score, for no seed was evaluated" in note
    with pytest.raises(ConfigError, match="c: has no score"):
        odaf.compare(runs, against=without)


def test_runs_of_long_names_are_numbered_in_pairs_so_that_lines_fit(tmp_path):
    runs = [scored_run(tmp_path / "a", FIRST), scored_run(tmp_path / "b", SECOND, "rorl")]
    long = "odaf without its outcome term"
    table = str(odaf.compare(runs, names=[long, "rorl"]))
    assert f"[1] {long}" in table and "[2] rorl" in table
    assert "[1] against [2]" in table and f"{long} against" not in table
    assert "odaf against rorl" in str(odaf.compare(runs))
