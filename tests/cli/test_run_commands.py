"""Train, resume, evaluate and report from the command line, on a tiny data set; and what bad files lead to."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

import odaf
from odaf.cli import main
from odaf.cli.results import print_run
from odaf.cli.train import values_of, with_ranges
from odaf.environments.maze import STITCH

TINY = (
    "--num-critics", "2", "--hidden-sizes", "8", "--batch-size", "8", "--outcome.dynamics.steps", "4",
    "--outcome.dynamics.hidden-sizes", "8", "--steps", "6", "--checkpoint-every", "3", "--quiet",
)  # fmt: skip
CLONING = ("--hidden-sizes", "8", "--batch-size", "8", "--checkpoint-every", "3", "--quiet")  # compiles in a moment


def write_data(path: Path, environment: dict | None) -> Path:
    """Four episodes of random steps in the shape of the maze task."""
    rng = np.random.default_rng(0)
    steps, episodes = 20, 4
    states = rng.uniform(-1, 1, (episodes, steps + 1, 4)).astype(np.float32)
    truncated = np.zeros((episodes, steps), bool)
    truncated[:, -1] = True
    odaf.Dataset.from_arrays(
        states[:, :-1].reshape(-1, 4),
        rng.uniform(-1, 1, (episodes * steps, 2)),
        rng.uniform(0, 1, episodes * steps),
        states[:, 1:].reshape(-1, 4),
        truncated=truncated.reshape(-1),
        action_bounds=(-1.0, 1.0),
        provenance={} if environment is None else {"environment": environment},
    ).save(path)
    return path


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_data(
        tmp_path_factory.mktemp("data") / "maze.h5",
        {"name": "pointmaze", "maze": STITCH.to_dict(), "steps": 10},
    )


@pytest.fixture(scope="module")
def run_directory(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of two seeds."""
    out = tmp_path_factory.mktemp("runs") / "maze"
    words = ["train", "odaf", "--data", str(data), "--out", str(out), "--seeds", "0", "1", "--episodes", "2", *TINY]
    assert main(words) == 0
    return out


def test_train_leaves_a_run_with_the_settings_of_its_options(run_directory: Path, data: Path):
    config = json.loads((run_directory / "config.json").read_text())
    assert config["preset"] == "odaf"
    assert config["steps"] == 6
    assert config["seeds"] == [0, 1]
    assert config["algorithm"]["num_critics"] == 2
    assert config["algorithm"]["terms"][0]["dynamics"]["steps"] == 4
    assert config["evaluate"]["episodes"] == 2
    assert json.loads((run_directory / "data.json").read_text())["path"] == str(data)
    assert [summary["step"] for summary in odaf.load_run(run_directory).summary.values()] == [6, 6]


def test_train_prints_where_each_seed_stands(run_directory: Path, data: Path, capsys: pytest.CaptureFixture[str]):
    words = ["train", "odaf", "--data", str(data), "--out", str(run_directory), "--seeds", "0", "1", "--episodes", "2"]
    assert main([*words, *TINY]) == 0  # the same command again continues the run, which is finished
    out = capsys.readouterr().out
    mean = odaf.load_run(run_directory).summary[1]["evaluation"]["mean_return"]
    assert "mean return" in out
    assert f"{mean:.1f}" in out
    assert f"odaf report {run_directory}" in out


def test_train_with_other_settings_into_the_same_directory_is_refused(
    run_directory: Path, data: Path, capsys: pytest.CaptureFixture[str]
):
    words = ["train", "odaf", "--data", str(data), "--out", str(run_directory), "--seeds", "0", "1", "--episodes", "2"]
    assert main([*words, *TINY, "--discount", "0.9"]) == 2
    assert "discount" in capsys.readouterr().err


def test_a_task_gives_the_defaults_and_options_change_them(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    taken = []
    monkeypatch.setattr("odaf.cli.train.train", lambda preset, algorithm, *others: taken.append(algorithm))
    words = ["train", "edac", "--data", "log.h5", "--out", "run"]
    for more in ([], ["--task", "hopper-medium"], ["--task=walker2d-medium-expert", "--num-critics", "4"]):
        main([*words, *more])
    assert [learner.num_critics for learner in taken] == [10, 50, 4]
    assert [learner.terms[0].weight for learner in taken] == [1.0, 1.0, 5.0]
    assert main([*words, "--task", "ant"]) == 2
    assert "no values for the task 'ant'; known: halfcheetah-random" in capsys.readouterr().err


def test_resume_makes_a_run_longer(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "run"
    words = ["train", "behaviour-cloning", "--data", str(data), "--out", str(out), "--evaluate-every", "0"]
    assert main([*words, "--steps", "6", *CLONING]) == 0
    assert main(["resume", str(out), "--steps", "9", "--quiet"]) == 0
    assert odaf.load_run(out).summary[0]["step"] == 9
    assert capsys.readouterr().out.count("finished") == 2


def test_resume_is_told_where_the_data_are_and_may_leave_the_evaluation_out(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    out, moved = tmp_path / "run", tmp_path / "moved.h5"
    log = tmp_path / "log.h5"
    log.write_bytes(data.read_bytes())
    words = ["train", "behaviour-cloning", "--data", str(log), "--out", str(out), "--episodes", "1"]
    assert main([*words, "--steps", "3", "--evaluate-every", "2", "--keep-checkpoints", "1", "0", *CLONING]) == 0
    log.rename(moved)
    assert main(["resume", str(out), "--steps", "6", "--quiet"]) == 2
    assert "--data FILE" in capsys.readouterr().err
    words = ["resume", str(out), "--quiet", "--data", str(moved)]
    assert main([*words, "--steps", "6", "--no-evaluation"]) == 0
    run = odaf.load_run(out)
    assert run.config["evaluate"] is None and run.summary[0]["evaluation"]["step"] == 3
    assert [checkpoint.step for checkpoint in run.checkpoints()] == [6]
    assert main([*words, "--no-evaluation", "--episodes", "2"]) == 2
    assert "--no-evaluation: leaves nothing" in capsys.readouterr().err
    assert main([*words, "--episodes", "2"]) == 0  # evaluated after all, where it stands
    assert odaf.load_run(out).summary[0]["evaluation"]["episodes"] == 2
    assert main(["evaluate", str(out), "--step", "3"]) == 2
    assert "this run keeps the last 1; --keep-checkpoints all" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("environment", "named"),
    [
        ("Hopper-v5", "Hopper-v5: its actions have shape (3,), the data's (2,)"),
        ("NoSuch-v0", "NoSuch-v0"),
        ("no_such_module:Plant-v0", "no_such_module"),
    ],
)
def test_an_environment_that_is_not_the_logs_stops_train_before_anything_is_written(
    environment: str, named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """A log that names no environment, as a plant's does, and one that does not fit it or does not exist."""
    data, out = write_data(tmp_path / "plant.h5", None), tmp_path / "run"
    words = ["train", "behaviour-cloning", "--data", str(data), "--out", str(out), "--env", environment]
    assert main([*words, "--steps", "3", *CLONING]) == 2
    assert named in capsys.readouterr().err
    assert not out.exists()


def test_train_with_the_wrong_environment_stops_before_anything_is_written(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    words = ["train", "behaviour-cloning", "--data", str(data), "--out", str(tmp_path / "run"), "--env", "Hopper-v5"]
    assert main([*words, "--steps", "3", *CLONING]) == 2
    assert "Hopper-v5: its actions have shape (3,), the data's (2,)" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


def test_evaluate_prints_and_writes_scores(run_directory: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = tmp_path / "scores.json"
    assert main(["evaluate", str(run_directory), "--episodes", "3", "--seed", "5", "--json", str(file)]) == 0
    scores = json.loads(file.read_text())
    assert set(scores["seeds"]) == {"0", "1"}
    assert 0.0 <= scores["success_rate"] <= 1.0
    assert "stitched" in capsys.readouterr().out


def test_evaluating_a_run_anew_with_its_own_seed_gives_its_own_scores(run_directory: Path, tmp_path: Path):
    file = tmp_path / "scores.json"
    assert main(["evaluate", str(run_directory), "--episodes", "2", "--json", str(file)]) == 0
    own = odaf.load_run(run_directory).summary
    found = json.loads(file.read_text())["seeds"]
    for seed in (0, 1):
        np.testing.assert_allclose(found[str(seed)]["mean_return"], own[seed]["evaluation"]["mean_return"], rtol=1e-6)


def test_evaluate_names_the_checkpoints_there_are(run_directory: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["evaluate", str(run_directory), "--step", "5"]) == 2
    err = capsys.readouterr().err
    assert "step 5" in err
    assert "3, 6" in err


def test_without_an_environment_train_says_so_and_evaluate_asks_for_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    data, out = write_data(tmp_path / "plant.h5", None), tmp_path / "run"
    words = ["train", "behaviour-cloning", "--data", str(data), "--out", str(out), "--steps", "6"]
    assert main([*words, *CLONING]) == 0
    printed = capsys.readouterr()
    assert "policies are not evaluated" in printed.err
    assert f"odaf assess {out} --data HOLDOUT" in printed.out
    assert main(["evaluate", str(out)]) == 2
    assert "--env" in capsys.readouterr().err
    run = odaf.load_run(out)
    monkeypatch.setattr(type(run.policy().actor), "takes_rewards", True)  # as MBRCSL's, which an assessment refuses
    print_run(run)
    printed = capsys.readouterr().out
    assert f"odaf evaluate {out} --env ID" in printed and "odaf assess" not in printed


def test_report_writes_one_page(run_directory: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    page = tmp_path / "report.html"
    assert main(["report", str(run_directory), "--out", str(page)]) == 0
    assert page.read_text(encoding="utf-8").lstrip().lower().startswith("<!doctype html>")
    assert str(page) in capsys.readouterr().out


def test_report_wants_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["report", "--out", str(tmp_path / "report.html")]) == 2
    assert "at least one run directory" in capsys.readouterr().err
    assert main(["report", str(tmp_path), "--out", str(tmp_path / "report.html")]) == 2
    assert str(tmp_path) in capsys.readouterr().err


@pytest.mark.parametrize("words", [["resume", "{}"], ["evaluate", "{}"]])
def test_a_directory_without_a_run_is_explained(words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main([word.format(tmp_path) for word in words]) == 2
    err = capsys.readouterr().err
    assert str(tmp_path / "config.json") in err and "`odaf.fit` wrote" in err
    assert len(err.splitlines()) == 1


def test_train_without_a_preset_lists_them(capsys: pytest.CaptureFixture[str]):
    assert main(["train"]) == 2
    err = capsys.readouterr().err
    assert "odaf-pessimistic" in err
    assert main(["train", "odaff", "--data", "x", "--out", "y"]) == 2
    assert "'odaff'" in capsys.readouterr().err


# ---- files that cannot be trusted ----------------------------------------------------------------------------------


def truncated(path: Path) -> str:
    path.write_bytes(path.read_bytes()[:-4000])
    return path.name


def corrupted(path: Path) -> str:
    with h5py.File(path, "r+") as file:
        found: list[str] = []
        file.visit(found.append)
        name = next(name for name in found if name.endswith("rewards"))
        file[name][3] += 1.0  # type: ignore[index,operator]
    return "damaged or edited"


def mislabelled(path: Path) -> str:
    path.write_text("x,y,reward\n0,0,1\n")
    return "HDF5"


def missing(path: Path) -> str:
    path.unlink()
    return "no such file"


@pytest.mark.parametrize("damage", [truncated, corrupted, mislabelled, missing])
@pytest.mark.parametrize("command", ["data info {data}", "train odaf --data {data} --out {out}"])
def test_a_bad_file_gives_one_message_and_code_2_and_leaves_nothing(
    damage, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    path, out = write_data(tmp_path / "log.h5", None), tmp_path / "run"
    named = damage(path)
    assert main(command.format(data=path, out=out).split()) == 2
    captured = capsys.readouterr()
    assert str(path) in captured.err
    assert named in captured.err
    assert len(captured.err.splitlines()) == 1
    assert captured.out == ""
    assert not out.exists()


def test_an_interrupted_run_says_how_to_go_on_and_does(data: Path, tmp_path: Path):
    out = tmp_path / "my run"
    words = ["train", "behaviour-cloning", "--data", str(data), "--out", str(out), "--evaluate-every", "0"]
    words += ["--steps", "100000000", *CLONING, "--checkpoint-every", "1000"]
    process = subprocess.Popen(
        [sys.executable, "-m", "odaf", *words], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    waited = time.monotonic() + 120
    while not list(out.glob("seed-0/checkpoints/*[1-9]*/header.json")) and time.monotonic() < waited:
        assert process.poll() is None, process.communicate()
        time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert err.splitlines()[-1].endswith(f"go on with: odaf resume '{out}'")
    assert odaf.load_run(out).summary[0]["step"] > 0


# ---- data commands -------------------------------------------------------------------------------------------------


def test_generate_then_info(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = tmp_path / "maze.h5"
    assert main(["data", "generate", "pointmaze-stitch", "--seed", "3", "--repeats", "1", "--out", str(file)]) == 0
    assert str(file) in capsys.readouterr().out
    assert main(["data", "info", str(file), "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    dataset = odaf.Dataset.load(file)
    assert facts["transitions"] == len(dataset)
    assert (facts["sha256"], facts["rows_sha256"]) == (dataset.file_fingerprint(), dataset.fingerprint())
    assert facts["provenance"]["seed"] == 3
    assert main(["data", "info", str(file)]) == 0
    page = capsys.readouterr().out
    assert f"{dataset.episode_returns().max():.2f}" in page
    assert dataset.fingerprint() in page
    assert "force_x" in page


def test_generate_takes_any_map(tmp_path: Path):
    plan = tmp_path / "corridor.json"
    plan.write_text(
        json.dumps(
            {
                "maze": {"name": "corridor", "rows": ["11111", "10001", "11111"], "start": [1, 1], "goal": [1, 3]},
                "routes": [{"name": "there", "goals": [[1, 2]], "repeats": 2}],
                "steps": 7,
            }
        )
    )
    file = tmp_path / "corridor.h5"
    assert main(["data", "generate", "pointmaze-stitch", "--maze", str(plan), "--out", str(file)]) == 0
    dataset = odaf.Dataset.load(file)
    assert dataset.num_episodes == 2
    assert len(dataset) == 14
    assert dataset.environment is not None
    assert dataset.environment["maze"]["name"] == "corridor"


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("{", "does not describe a maze"),
        ("[]", "does not describe a maze"),
        ('{"maze": 3, "routes": []}', "does not describe a maze"),
        ('{"routes": []}', "missing fields ['maze']"),
    ],
)
def test_a_map_that_cannot_be_read_is_explained(
    text: str, named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    plan = tmp_path / "plan.json"
    plan.write_text(text)
    assert main(["data", "generate", "pointmaze-stitch", "--maze", str(plan), "--out", str(tmp_path / "x.h5")]) == 2
    err = capsys.readouterr().err
    assert str(plan) in err
    assert named in err


def test_an_unknown_maze_is_explained(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["data", "generate", "pointmaze-stitch", "--maze", "nowhere", "--out", str(tmp_path / "x.h5")]) == 2
    assert "neither a known maze (stitch" in capsys.readouterr().err


def test_a_place_that_is_not_there_is_explained(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = tmp_path / "no" / "such" / "x.h5"
    assert main(["data", "generate", "pointmaze-stitch", "--repeats", "1", "--out", str(file)]) == 2
    assert str(file) in capsys.readouterr().err


@pytest.mark.parametrize("how", [("--lanes", "4"), ("--workers", "1")], ids=["lanes", "one after another"])
def test_a_run_for_each_data_set_and_value(data: Path, tmp_path: Path, capsys, how):
    other = write_data(tmp_path / "other.h5", {"name": "pointmaze", "maze": STITCH.to_dict(), "steps": 10})
    words = ["train", "behaviour-cloning", "--data", str(data), str(other), "--out", str(tmp_path / "runs")]
    words += ["--seeds", "0..1", "--set", "learning-rate=1e-3,3e-4", "batch_size=8", "--episodes", "2"]
    words += ["--hidden-sizes", "8", "--steps", "6", "--checkpoint-every", "3", "--quiet", *how]
    assert main(words) == 0
    printed = capsys.readouterr().out
    names = {f"{name},learning_rate={rate}" for name in ("maze", "other") for rate in ("0.001", "0.0003")}
    assert {child.name for child in (tmp_path / "runs").iterdir()} == names
    for name in names:
        run = odaf.load_run(tmp_path / "runs" / name)
        assert run.files.seeds == (0, 1) and run.scores().by_seed[1].step == 6
        assert run.files.config["algorithm"]["batch_size"] == 8 and name in printed
    assert main(words) == 0  # nothing is left to do


def test_data_without_an_environment_leave_the_evaluation_of_others_alone(data: Path, tmp_path: Path, capsys):
    plant, folder = write_data(tmp_path / "plant.h5", None), tmp_path / "my runs"
    words = ["train", "behaviour-cloning", "--data", str(plant), str(data), "--out", str(folder), *CLONING]
    words += ["--steps", "6", "--episodes", "2", "--seeds=0..1"]
    for _ in range(2):  # the second time nothing is left to do
        assert main([*words, "--lanes", "4"]) == 0
        printed, said = capsys.readouterr()
        assert said.startswith(f"{plant} names no environment and no --env was given: policies of these data are not")
        assert f"odaf report '{folder}' --out" in printed
    assert main([*words, "--lanes", "4", "--steps", "9"]) == 2
    assert f"`odaf resume '{folder}/plant' --steps 9`" in capsys.readouterr().err
    assert [odaf.load_run(folder / name).files.config["evaluate"] is None for name in ("plant", "maze")] == [
        True,
        False,
    ]
    assert odaf.load_run(folder / "maze").scores().by_seed[1].step == 6
    assert (
        main([*words[:2], "--data", str(data), *words[5:], "--set", "batch_size=4,8", "--out", str(folder / "maze")])
        == 2
    )
    assert "maze: holds a run; several runs need a folder of their own" in capsys.readouterr().err


@pytest.mark.parametrize("how", [("--lanes", "2"), ("--workers", "1")], ids=["lanes", "one after another"])
def test_every_environment_is_examined_before_the_first_of_several_runs(data: Path, tmp_path: Path, capsys, how):
    other = write_data(tmp_path / "other.h5", {"name": "gymnasium", "id": "Hopper-v5"})
    words = ["train", "behaviour-cloning", "--data", str(data), str(other), "--out", str(tmp_path / "runs"), *CLONING]
    assert main([*words, "--steps", "3", "--episodes", "1", *how]) == 2
    assert "Hopper-v5: its actions have shape" in capsys.readouterr().err
    assert not (tmp_path / "runs").exists()


def test_values_and_ranges_are_read_or_refused(capsys):
    assert with_ranges(["--seeds", "0..2", "7", "--out", "0..2"]) == ["--seeds", "0", "1", "2", "7", "--out", "0..2"]
    assert values_of(["outcome.weight=0.1,1", "hidden-sizes=[8,8],[16]", "critic_norm=none,layer", "a=true"]) == {
        "outcome.weight": [0.1, 1], "hidden_sizes": [[8, 8], [16]], "critic_norm": ["none", "layer"], "a": [True]
    }  # fmt: skip
    for words, match in (
        (["outcome.weight"], "a setting and its values"),
        (["=1"], "a setting and its values"),
        (["a=1,"], "a setting and its values"),
        (["a=1", "a=2"], "stands there twice"),
    ):
        with pytest.raises(odaf.ConfigError, match=match):
            values_of(words)
    for words in (["--seeds", "3..1"], ["--seeds", "0..99999999"]):
        with pytest.raises(odaf.ConfigError, match="smaller number first"):
            with_ranges(words)
    assert with_ranges(["--seeds=0..1", "--out=0..1"]) == ["--seeds", "0", "1", "--out=0..1"]
    words = ["train", "td3-bc", "--data", "x.h5", "--out", "x", "--set"]
    assert main([*words, "discount="]) == 2, "an option of the same name is not meant"
    assert "--set 'discount=': write a setting" in capsys.readouterr().err
