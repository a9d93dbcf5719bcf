"""Scores of a run's seeds."""

import math

import pytest

import odaf
from golden.runs import dataset_of, untrained_run
from odaf.errors import CheckpointError
from odaf.evaluation.scores import scores_from
from odaf.training import checkpoints


def _summary(mean, step=10, **rates):
    evaluation = {"step": step, "mean_return": mean, "std_return": 1.0, "episodes": 2, "returns": [mean - 1, mean + 1]}
    return {"status": "finished", "evaluation": {**evaluation, **rates}}


def test_scores_over_four_seeds_by_hand():
    summaries = {seed: _summary(mean, success_rate=rate) for seed, mean, rate in _ROWS}
    scores = scores_from(summaries, "runs/a")
    assert scores.mean == 122.0 and scores.std == pytest.approx(4.320494, abs=1e-6)
    assert scores.estimate().low == pytest.approx(115.125131, abs=1e-4)
    assert scores.rate("success_rate") == pytest.approx(0.8) and scores.rate("stitched_rate") is None
    assert scores.by_seed[1].returns == (121.0, 123.0)
    assert scores.to_dict()["seeds"]["3"] == {
        "step": 10, "mean_return": 128.0, "std_return": 1.0, "success_rate": 0.8, "returns": [127.0, 129.0],
    }  # fmt: skip
    assert str(scores).startswith("return 122.0 ± 4.3")


_ROWS = [(0, 118.0, 1.0), (1, 122.0, 0.8), (2, 120.0, 0.6), (3, 128.0, 0.8)]


def test_one_seed_gives_a_mean_and_no_interval():
    scores = scores_from({4: _summary(7.0)}, "runs/a")
    assert scores.mean == 7.0 and math.isnan(scores.std)


def test_seed_without_evaluation_is_named():
    with pytest.raises(CheckpointError, match=r"runs/a: no evaluation of seeds 1, 2 yet"):
        scores_from({0: _summary(1.0), 1: {"evaluation": None}, 2: {}}, "runs/a")


def test_rate_that_one_seed_lacks_is_not_averaged_over_the_others():
    assert scores_from({0: _summary(1.0, success_rate=1.0), 1: _summary(1.0)}, "a").rate("success_rate") is None


def test_a_run_knows_its_environment_and_its_metrics_are_one_table(tmp_path):
    environment = {"name": "gymnasium", "id": "Hopper-v4", "kwargs": {}}
    directory = untrained_run(
        tmp_path / "run", odaf.BehaviourCloning(hidden_sizes=(4,)), dataset_of(11, 3, environment)
    )
    run = odaf.load_run(directory)
    for seed in run.seeds:
        summary = run.files.summary(seed) | {"evaluation": _summary(1000.0 + seed)["evaluation"]}
        checkpoints.rewrite_record(run.checkpoints(seed)[-1], {"summary": summary})
        (directory / f"seed-{seed}" / "metrics.jsonl").write_text(
            f'{{"step": 2, "loss": {seed}.5, "time/seconds": 1}}\n{{"step": 2, "evaluation/return_mean": null}}\n'
            '{"step": 4, "loss": null}\n{"step": 4, "loss": 7.0}\n{"step": 6, "lo'
        )
    normalised = run.scores().normalised
    assert normalised is not None and normalised["environment"] == "Hopper-v4"
    assert normalised["mean_return"] == 1000.5

    table = run.metrics()
    assert table.columns == ["seed", "step", "evaluation/return_mean", "loss", "time/seconds"]
    assert table.select("seed", "step", "loss").rows() == [(0, 2, 0.5), (0, 4, 7.0), (1, 2, 1.5), (1, 4, 7.0)]
    assert table["time/seconds"].to_list() == [1.0, None, 1.0, None]
    assert run.metrics(1)["seed"].unique().to_list() == [1]


def test_an_episode_that_broke_off_is_no_number_and_counts_in_no_mean():
    summary = _summary(5.0)
    summary["evaluation"] |= {"returns": [4.0, None, 6.0], "broken_episodes": 1}
    (score,) = scores_from({0: summary}, "runs/a").by_seed
    assert score.mean_return == 5.0 and math.isnan(score.returns[1])
    summary["evaluation"] |= {"mean_return": None, "std_return": None, "returns": [None]}
    without = scores_from({0: summary, 1: _summary(5.0)}, "runs/a")
    assert math.isnan(without.mean)
    assert str(without) == "no mean return: every episode of seeds 0 broke off on a number that is not finite"
