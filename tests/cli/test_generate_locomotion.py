"""`odaf data generate` for locomotion: names, options that do not apply, what it prints."""

import re
from pathlib import Path
from typing import get_args

import pytest

from odaf.cli import main
from odaf.cli.data import GenerateOptions
from odaf.data import Dataset
from odaf.environments.ant_maze_sets import NAMES as ANT_MAZE_NAMES
from odaf.environments.locomotion_data import NAMES


def test_the_command_knows_every_set():
    kind = GenerateOptions.__dataclass_fields__["name"].type
    names = set(get_args(get_args(kind)[0])) if get_args(kind) else set()
    assert names == {"pointmaze-stitch", *NAMES, *ANT_MAZE_NAMES}


def test_a_random_set_is_written_with_its_score(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = tmp_path / "set.h5"
    words = ["data", "generate", "hopper-random", "--transitions", "500", "--seed", "2", "--out", str(file)]
    assert main(words) == 0
    out = capsys.readouterr().out
    assert "500 transitions" in out and "Hopper-v4: normalised score" in out and "transitions/s" in out
    dataset = Dataset.load(file)
    assert len(dataset) == 500 and dataset.provenance["seed"] == 2
    assert dataset.infos["qpos"].shape == (500, 6)


def test_info_says_of_which_edition_a_set_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    file = tmp_path / "set.h5"
    words = ["data", "generate", "halfcheetah-medium", "--transitions", "40", "--edition", "1", "--out", str(file)]
    assert main(words) == 0 and main(["data", "info", str(file)]) == 0
    assert re.search(r"^edition +1 of the shipped policies$", capsys.readouterr().out, re.MULTILINE)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["hopper-random", "--maze", "stitch"], "--maze is for mazes"),
        (["hopper-random", "--repeats", "2"], "--repeats is for mazes"),
        (["pointmaze-stitch", "--transitions", "5"], "--transitions is for locomotion"),
        (["pointmaze-stitch", "--version", "v4"], "--version is for locomotion"),
        (["hopper-medium", "--exact", "DIR"], "only medium-replay sets"),
        (["antmaze-umaze", "--version", "v4"], "--version does not apply to antmaze-umaze, which takes --transitions"),
        (["hopper-medium-replay", "--exact", "DIR", "--transitions", "5"], "as long as its training"),
    ],
)
def test_options_that_do_not_apply_are_refused(tmp_path, capsys, words, message):
    words = [str(tmp_path / "run") if word == "DIR" else word for word in words]
    assert main(["data", "generate", *words, "--out", str(tmp_path / "set.h5")]) == 2
    assert message in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
