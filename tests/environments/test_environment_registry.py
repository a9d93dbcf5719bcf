"""From descriptions to environments, and what is said when that fails."""

import sys

import gymnasium
import numpy as np
import pytest

from odaf.environments import make
from odaf.environments.maze import STITCH
from odaf.environments.point_maze import PointMaze
from odaf.errors import ConfigError

DESCRIPTION = {"name": "pointmaze", "maze": STITCH.to_dict(), "steps": 50}


def test_point_maze():
    factory = make(DESCRIPTION)
    first, second = factory(), factory()
    assert isinstance(first, PointMaze) and first is not second
    assert first.maze == STITCH and first.steps == 50
    unlimited = make({"name": "pointmaze", "maze": STITCH.to_dict()})()
    assert isinstance(unlimited, PointMaze) and unlimited.steps == 200


def test_gymnasium():
    environment = make({"name": "gymnasium", "id": "Hopper-v5", "kwargs": {"terminate_when_unhealthy": False}})()
    assert isinstance(environment, gymnasium.Env)
    observation, _ = environment.reset(seed=0)
    assert observation.shape == (11,) and np.isfinite(observation).all()
    environment.close()


def test_bodies_of_version_4_are_made_without_notices(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)  # the simulator would write a file here
    make({"name": "gymnasium", "id": "HalfCheetah-v4"})().close()  # a warning would be an error
    assert list(tmp_path.iterdir()) == [] and capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("description", "message"),
    [
        ({"name": "chess"}, "name is 'chess'; known are 'pointmaze' and 'gymnasium'"),
        ({}, "name is None; known are"),
        ({"name": "pointmaze"}, r"missing \['maze'\]"),
        ({**DESCRIPTION, "speed": 3}, r"unknown \['speed'\]"),
        ({**DESCRIPTION, "steps": 0}, "steps is 0"),
        ({**DESCRIPTION, "maze": {"rows": []}}, r"maze: missing fields \['goal', 'start'\]"),
        ({"name": "gymnasium", "id": "Hoper-v5"}, "environment 'Hoper-v5': gymnasium does not know it"),
    ],
)
def test_bad_descriptions(description, message):
    with pytest.raises(ConfigError, match=message):
        make(description)


@pytest.mark.parametrize(
    ("missing", "description"),
    [
        ("odaf.environments.point_maze", DESCRIPTION),
        ("gymnasium", {"name": "gymnasium", "id": "Hopper-v5"}),
    ],
)
def test_missing_simulator_names_the_extra(monkeypatch, missing, description):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(ConfigError, match=r'pip install "odaf\[envs\]"'):
        make(description)
