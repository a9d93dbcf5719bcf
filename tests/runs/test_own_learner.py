"""A learner of the user's own, which the package does not know: in Python and on the command line."""

import dataclasses
import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, ClassVar

import jaxtyping
import numpy as np
import pytest

import odaf
from battery import learners
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.algorithms.registry import ALGORITHMS, TERMS, register_parts
from odaf.environments import stitch_data
from odaf.errors import CheckpointError, ConfigError
from odaf.runs import presets

EXAMPLES = Path(odaf.__file__).parents[2] / "examples"
SMALL = {"hidden_sizes": (8,), "batch_size": 16}


@pytest.fixture
def awac(monkeypatch):
    """The example's class, imported as a user's own module would be."""
    monkeypatch.syspath_prepend(EXAMPLES)
    monkeypatch.setattr(ALGORITHMS, "_known", dict(ALGORITHMS._known))
    spec = importlib.util.spec_from_file_location("awac", EXAMPLES / "awac.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "awac", module)
    spec.loader.exec_module(module)
    yield module.AWAC
    sys.modules.pop("awac", None)


@pytest.fixture(scope="module")
def maze():
    return stitch_data.generate(stitch_data.CONFIGS["stitch"].with_repeats(1), seed=0)


def test_it_trains_resumes_and_is_evaluated_from_python(awac, maze, tmp_path):
    assert "awac" not in ALGORITHMS
    learner = awac(**SMALL)
    run = odaf.fit(
        learner, maze, steps=4, directory=tmp_path / "run", progress=False, evaluate=odaf.Rollouts(episodes=2, every=4)
    )
    assert run.scores().by_seed[0].step == 4
    run = odaf.resume(tmp_path / "run", steps=6, dataset=maze, progress=False)
    assert run.summary[0]["step"] == 6
    assert odaf.evaluate(tmp_path / "run", episodes=2).by_seed[0].step == 6
    assert run.policy()(maze.observations[:3]).shape == (3, 2)
    del ALGORITHMS._known["awac"]  # as in another process
    with pytest.raises(CheckpointError, match="kind='awac' is not a learner.*odaf.register"):
        odaf.load_run(tmp_path / "run").policy()


def test_several_values_of_its_numbers_make_several_runs(awac, maze, tmp_path):
    assert "awac" not in ALGORITHMS
    maze.save(tmp_path / "maze.h5")
    plans = odaf.combinations(awac(**SMALL), [tmp_path / "maze.h5"], {"temperature": [0.5, 1.0]}, tmp_path / "runs")
    assert [plan.algorithm for plan in plans] == [awac(**SMALL, temperature=each) for each in (0.5, 1.0)]


def test_it_prefers_the_better_half_of_what_was_logged(awac, tmp_path):
    """The reward is the action, whatever the state."""
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (2000, 1)).astype(np.float32)
    log = odaf.Dataset.from_arrays(
        np.ones((2000, 1)) * rng.choice([-1.0, 1.0], (2000, 1)), actions, actions[:, 0],
        terminated=np.ones(2000, bool), action_bounds=(-1.0, 1.0),
    )  # fmt: skip
    learner = awac(hidden_sizes=(32,), batch_size=128, learning_rate=3e-3, temperature=0.2)
    run = odaf.fit(learner, log, steps=400, directory=tmp_path / "probe", progress=False)
    assert float(run.policy()(np.ones((1, 1), np.float32))[0, 0]) > 0.3  # plain cloning gives 0


SCRIPT = """
import sys
import odaf
from awac import AWAC

if __name__ == "__main__":
    odaf.fit(
        AWAC(hidden_sizes=(8,), batch_size=16), sys.argv[1], steps=2, seeds=(0, 1), workers=2, directory=sys.argv[2],
        progress=False,
    )
    print(sorted(odaf.load_run(sys.argv[2]).summary))
"""


def test_workers_know_it_too(maze, tmp_path):
    maze.save(tmp_path / "maze.h5")
    (tmp_path / "script.py").write_text(SCRIPT)
    done = _run(tmp_path, "script.py", "maze.h5", "run")
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[0, 1]"


def _run(folder: Path, *words: str, **environment: str) -> subprocess.CompletedProcess:
    paths = [str(Path(odaf.__file__).parents[1]), str(EXAMPLES), str(folder)]
    return subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths), **environment},
        capture_output=True,
        text=True,
        timeout=400,
    )


def test_the_command_line_knows_it_by_an_entry_point(maze, tmp_path):
    maze.save(tmp_path / "maze.h5")
    offer = tmp_path / "awac_for_odaf-1.0.dist-info"
    offer.mkdir()
    (offer / "METADATA").write_text("Metadata-Version: 2.1\nName: awac-for-odaf\nVersion: 1.0\n")
    (offer / "entry_points.txt").write_text("[odaf.algorithms]\nawac = awac:AWAC\n")
    (tmp_path / "mine.toml").write_text((EXAMPLES / "awac.toml").read_text() + "hidden_sizes = [8]\nbatch_size = 16\n")
    options = ["--steps", "2", "--episodes", "2", "--learning-rate", "1e-3", "--quiet"]
    done = _run(tmp_path, "-m", "odaf", "train", "./mine.toml", "--data", "maze.h5", "--out", "run", *options)
    assert done.returncode == 0, done.stderr
    settings = json.loads((tmp_path / "run" / "config.json").read_text())["algorithm"]
    assert settings["kind"] == "awac" and settings["learning_rate"] == 1e-3 and settings["temperature"] == 0.5
    again = _run(tmp_path, "-m", "odaf", "evaluate", "run", "--episodes", "2")
    assert again.returncode == 0, again.stderr


def test_an_unknown_learner_fails_before_a_directory_is_claimed(maze, tmp_path):
    @dataclasses.dataclass(frozen=True)
    class Impostor(BehaviourCloning):
        kind: ClassVar[str] = "behaviour-cloning"

    with pytest.raises(ConfigError, match="the name 'behaviour-cloning' belongs to odaf"):
        odaf.fit(Impostor(), maze, steps=2, directory=tmp_path / "run", progress=False)
    assert not (tmp_path / "run").exists()


def test_what_is_no_learner_and_no_term_cannot_be_registered():
    with pytest.raises(ConfigError, match="is not a dataclass derived from Algorithm"):
        odaf.register(dict)
    not_a_learner: Any = "odaf"
    with pytest.raises((ConfigError, jaxtyping.TypeCheckError), match="odaf"):
        register_parts(not_a_learner)
    assert set(TERMS) >= {"outcome", "ood"} and len(TERMS) >= 8


def test_a_preset_of_ones_own_extends_one_of_ours(tmp_path):
    mine = tmp_path / "mine.toml"
    mine.write_text(
        'description = "wider"\nextends = "odaf"\nnum_critics = 4\n[[terms]]\nname = "outcome"\nweight = 2.0\n'
    )
    learner = presets.load(str(mine))
    assert learner == presets.load("odaf", {"num_critics": 4, "outcome.weight": 2.0})
    (tmp_path / "narrow.toml").write_text('extends = "./mine.toml"\nhidden_sizes = [32]\n')
    assert presets.load(str(tmp_path / "narrow.toml")).num_critics == 4
    assert learners.small(learner).num_critics == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("num_critics = 4", "needs a line such as extends"),
        ("num_critics = ", "cannot be read as TOML"),
        ('extends = "nothing"', "preset 'nothing' does not exist; known: .*odaf"),
        ('extends = "odaf"\nwithout = ["weather"]', "without names 'weather', which is no term; known: outcome"),
        ('kind = "weather"', "kind='weather' is not a learner; known: ensemble-sac.*odaf.algorithms"),
    ],
)
def test_a_preset_that_cannot_be_read_says_why(tmp_path, text, message):
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(ConfigError, match=message):
        presets.load(str(tmp_path / "mine.toml"))


def test_a_preset_file_that_is_not_there_is_named():
    with pytest.raises(ConfigError, match="preset ./nowhere.toml: there is no such file"):
        presets.load("./nowhere.toml")
