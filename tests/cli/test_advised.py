"""`odaf data check` ends with advice, and `odaf train auto` takes it."""

import json
from pathlib import Path

import h5py
import numpy as np
import pytest

import odaf
from data.checks import healthy
from odaf.cli import main
from odaf.cli.process import values_given

TINY = ("--hidden-sizes", "8", "--batch-size", "8", "--checkpoint-every", "3", "--evaluate-every", "0", "--quiet")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("data") / "tank.h5"
    odaf.Dataset.from_log(healthy.log()).save(path)
    return path


@pytest.fixture(scope="module")
def spoiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same in D4RL's layout, with a reward that is no number."""
    path = tmp_path_factory.mktemp("data") / "spoiled.hdf5"
    columns = healthy.columns()
    columns["rewards"][4] = np.nan
    with h5py.File(path, "w") as file:
        for name in ("observations", "actions", "rewards"):
            file[name] = columns[name].astype(np.float32)
        file["terminals"], file["timeouts"] = columns["terminated"], columns["truncated"]
    return path


def test_the_check_ends_with_what_to_begin_with(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["data", "check", str(log), "--json", str(tmp_path / "report.json")]) == 0
    page = capsys.readouterr().out
    section = page[page.index("what to begin with (few-rows):") :]
    assert f"odaf train behaviour-cloning --hidden-sizes 64 64 --data {log} --out DIR" in section
    assert "2,990 rows are few" in section
    assert "`odaf train auto --data FILE --out DIR` takes this advice" in section.splitlines()[-1]
    advice = json.loads((tmp_path / "report.json").read_text())["advice"]
    assert advice["preset"] == "behaviour-cloning" and advice["settings"] == {"hidden_sizes": [64, 64]}
    assert advice["statistics"]["rows"] == 2_990


def test_errors_come_before_advice(spoiled: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["data", "check", str(spoiled), "--json", str(tmp_path / "report.json")]) == 2
    page = capsys.readouterr().out
    assert "what to begin with: errors come first; mend them and check again" in page and "odaf train" not in page
    assert json.loads((tmp_path / "report.json").read_text())["advice"] is None
    out = tmp_path / "run"
    assert main(["train", "auto", "--data", str(spoiled), "--out", str(out), *TINY]) == 2
    assert "the checks find errors (first: not-finite:" in capsys.readouterr().err
    assert not out.exists()


def test_a_table_is_imported_first(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    columns = healthy.columns()
    rows = np.column_stack([columns["observations"], columns["actions"], columns["rewards"], columns["episode"]])
    table = tmp_path / "tank.csv"
    np.savetxt(table, rows, delimiter=",", header="a,b,c,u,v,profit,batch", comments="")
    words = "--observations a b c --actions u v --reward profit --episode batch --never-terminated --action-bounds -1 1"
    assert main(["data", "check", str(table), *words.split()]) == 0
    page = capsys.readouterr().out
    assert "--data LOG.h5 --out DIR" in page and "as `odaf data import` keeps it" in page


def test_auto_trains_what_is_advised_and_records_why(log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "run"
    words = ["train", "auto", "--data", str(log), "--out", str(out), "--seeds", "0", "--steps", "3", *TINY]
    assert main(words) == 0
    err = capsys.readouterr().err
    assert "what to begin with (few-rows):" in err and "2,990 rows are few" in err and f"--out {out}" in err
    config = json.loads((out / "config.json").read_text())
    assert config["preset"] == "behaviour-cloning" and config["advice"]["case"] == "few-rows"
    assert config["algorithm"]["hidden_sizes"] == [8]  # what the user says goes before the advised 64 64
    assert main(words) == 0  # the same command goes on with the run, which is finished
    assert main(["resume", str(out), "--steps", "6", "--quiet"]) == 0
    run = odaf.load_run(out)
    assert run.summary[0]["step"] == 6 and run.config["advice"] == config["advice"]


def test_each_of_several_values_records_the_advice(log: Path, tmp_path: Path):
    words = ["train", "auto", "--data", str(log), "--out", str(tmp_path), "--set", "learning_rate=1e-3,1e-4"]
    assert main([*words, "--steps", "3", "--workers", "1", *TINY]) == 0
    configs = [json.loads(path.read_text()) for path in sorted(tmp_path.glob("*/config.json"))]
    assert len(configs) == 2 and all(config["advice"]["case"] == "few-rows" for config in configs)


def test_advised_settings_are_defaults(log: Path, monkeypatch: pytest.MonkeyPatch):
    taken = []
    monkeypatch.setattr("odaf.cli.train.train", lambda *words: taken.append(words))
    assert main(["train", "auto", "--data", str(log), "--out", "run"]) == 0
    ((preset, learner, *_, advice),) = taken
    assert preset == "behaviour-cloning" and learner.hidden_sizes == (64, 64) and advice["case"] == "few-rows"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--out run", "auto: --data: name the data set"),
        ("--data a.h5 b.h5 --out run", "2 files are named, and each may ask for another method"),
        ("--data no.h5 --out run", "no.h5: there is no such file"),
    ],
)
def test_auto_refuses(words: str, said: str, capsys: pytest.CaptureFixture[str]):
    assert main(["train", "auto", *words.split()]) == 2
    assert said in capsys.readouterr().err


def test_auto_has_a_page_of_its_own(capsys: pytest.CaptureFixture[str]):
    assert main(["train", "auto", "--help"]) == 0
    assert "say which method to begin with and why" in capsys.readouterr().out
    assert main(["train", "--help"]) == 0
    assert "odaf train auto" in capsys.readouterr().out


def test_words_behind_an_option():
    words = ["--data", "a", "b", "--out", "c", "--data=d", "--steps", "3"]
    assert values_given(words, "--data") == ["a", "b", "d"]
    assert values_given(words, "--seeds") == []
