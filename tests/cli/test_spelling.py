"""Messages on the command line: options with dashes, and the command that takes those of a reader."""

import inspect
import json
import shlex
from importlib import import_module
from pathlib import Path

import h5py
import numpy as np
import polars as pl
import pytest

from odaf.cli import main, spelling
from odaf.data.readers import FORMATS


@pytest.fixture(autouse=True)
def importing():
    """As if `odaf data import` were running."""
    spelling.command_takes(spelling.reader_options())
    yield
    spelling.command_takes(())


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("pass max_episode_steps=1000 here", "pass --max-episode-steps 1000 here"),
        ("give observations=, actions=, reward=", "give --observations, --actions, --reward"),
        ("pass reward=0.0 for cloning", "pass --constant-reward 0.0 for cloning"),
        ("pass reward=-1.", "pass --constant-reward -1."),
        ('reward="zero"', "--reward zero"),
        ("pass episode=0 if all", "pass --single-episode if all"),
        ("pass terminated=False", "pass --never-terminated"),
        ("pass sort_by=['batch id', 't']", "pass --sort-by 'batch id' t"),
        ("observations=[0, 1]", "--observations 0 1"),
        ("pass goal=(x, y) for", "pass --goal x y for"),
        ("action_bounds={'valve': (0, 100)}", "--action-bounds 0 100"),
        ('on_gap="break" to end', "--on-gap break to end"),
        ("format='csv', encoding= or", "--format csv, --encoding or"),
        ("d4rl_compat=True", "--d4rl-compat"),
        ("no option=3, colour= or x == 4", "no option=3, colour= or x == 4"),
        ("runs/poor,reward=0.1: is a path", "runs/poor,reward=0.1: is a path"),
    ],
)
def test_options_get_their_dashes(text: str, shown: str):
    assert spelling.spelled(text) == shown


def test_every_option_of_every_reader_can_be_given_on_the_command_line():
    for layout in FORMATS.values():
        parameters = inspect.signature(import_module(layout.module).read).parameters.values()
        missing = {p.name for p in parameters if p.kind is p.KEYWORD_ONLY} - spelling.reader_options()
        assert not missing, layout.name


def write_d4rl(path: Path, width: float = 1.0, **fields: np.ndarray) -> Path:
    rng = np.random.default_rng(0)
    with h5py.File(path, "w") as file:
        file["observations"] = rng.normal(size=(300, 2)).astype(np.float32)
        file["actions"] = (width * rng.uniform(-1, 1, (300, 1))).astype(np.float32)
        file["rewards"] = rng.normal(size=300)
        for name, values in fields.items():
            file[name] = values
    return path


def refusal(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main([*words]) == 2
    return capsys.readouterr().err


def test_training_names_the_command_that_reads_such_a_file_and_it_does(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    table = tmp_path / "my log.csv"
    table.write_text("e,x,a,r\n" + "".join(f"{i // 50},{i % 7},{(i * i) % 11 - 5},1\n" for i in range(300)))
    files = {
        "--observations x --actions a --reward r --episode e --accept too-few": table,
        "--action-bounds -2 2 --accept too-few": write_d4rl(
            tmp_path / "wide.h5", 2.0, terminals=np.zeros(300, bool), timeouts=np.arange(300) % 50 == 49
        ),
        "--max-episode-steps 1000 --accept too-few": write_d4rl(tmp_path / "v0.h5", terminals=np.zeros(300, bool)),
    }
    for given, file in files.items():
        said = refusal(capsys, "train", "behaviour-cloning", "--data", str(file), "--out", str(tmp_path / "run"))
        command = shlex.split(said.split("`")[-2])
        assert command[:4] == ["odaf", "data", "import", str(file)], said
        named = {word for word in command if word.startswith("--")}
        assert "--out" in named and named <= {"--out", *(word for word in given.split() if word[:2] == "--")}, said
        assert f" {sorted(named)[0]}" in f" {said.partition('. This')[0]}" or "--out" in sorted(named)[0]
        assert main(["data", "import", str(file), *given.split(), "--out", str(tmp_path / "new.h5")]) == 0
        capsys.readouterr()


def test_a_lerobot_folder_without_rewards_is_imported_with_the_option_that_the_message_names(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    rng = np.random.default_rng(0)
    folder = tmp_path / "arm"
    (folder / "data" / "chunk-000").mkdir(parents=True)
    (folder / "meta").mkdir()
    (folder / "meta" / "info.json").write_text(json.dumps({"codebase_version": "v3.0", "fps": 10, "features": {}}))
    pl.DataFrame(
        {
            "observation.state": rng.normal(size=(40, 2)),
            "action": rng.uniform(-1, 1, (40, 1)),
            "timestamp": np.tile(np.arange(20) / 10, 2),
            "episode_index": np.repeat([0, 1], 20),
        }
    ).write_parquet(folder / "data" / "chunk-000" / "file-000.parquet")
    out = tmp_path / "arm.h5"
    said = refusal(capsys, "data", "import", str(folder), "--out", str(out))
    assert "--constant-reward 0.0" in said and "reward=" not in said
    words = ["--constant-reward", "0.0", "--never-terminated", "--accept", "too-few", "--out", str(out)]
    assert main(["data", "import", str(folder), *words]) == 0
