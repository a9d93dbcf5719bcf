"""Learners as users have them, with side networks and terms, through training, a cut, and going on."""

import json
import shutil

import numpy as np
import pytest

import odaf
from odaf import training

_SMALL = {"num_critics": 2, "hidden_sizes": (8, 8), "batch_size": 16}
_DYNAMICS = {"kind": "ensemble", "members": 3, "elites": 2, "steps": 20, "hidden_sizes": (8,), "batch_size": 16}


@pytest.mark.parametrize(
    ("preset", "settings"),
    [
        pytest.param("odaf", {**_SMALL, "outcome": {"dynamics": _DYNAMICS}}, marks=pytest.mark.slow),
        ("behaviour-cloning", {"hidden_sizes": (8, 8)}),
    ],
)
def test_cut_run_goes_on_to_the_bits_of_the_whole_one(tiny, tmp_path, preset, settings):
    learner, dataset = odaf.preset(preset, **settings), tiny.tiny_dataset()
    run = training.fit(
        learner, dataset, steps=6, directory=tmp_path / "run", checkpoint_every=2, stretch=2, progress=False
    )
    arrays, lines = tiny.arrays_of(run.path), tiny.lines_of(run.path)
    assert run.algorithm == learner and len(arrays) == 4
    for step in (4, 6):
        shutil.rmtree(run.checkpoint(0, step).path)
    training.fit(learner, dataset, steps=6, directory=tmp_path / "run", checkpoint_every=2, stretch=2, progress=False)
    assert tiny.arrays_of(run.path) == arrays and tiny.lines_of(run.path) == lines
    actions = run.policy(0)(dataset.observations)
    assert (actions >= dataset.action_low).all() and (actions <= dataset.action_high).all()
    assert not np.array_equal(actions, run.policy(0, 0)(dataset.observations))


def test_policy_of_a_run_whose_config_was_changed_is_refused(tiny, tmp_path):
    learner = odaf.BehaviourCloning(hidden_sizes=(8,))
    run = training.fit(learner, tiny.tiny_dataset(), steps=2, directory=tmp_path / "run", progress=False)
    path = run.path / "config.json"
    config = json.loads(path.read_text())
    path.write_text(json.dumps({**config, "algorithm": {**config["algorithm"], "hidden_sizes": [9]}}))
    with pytest.raises(odaf.CheckpointError, match=r"header\.json: leaves: .*\[3, 9\].*\[3, 8\].*config\.json"):
        training.load_run(run.path).policy(0)
    path.write_text(json.dumps({**config, "algorithm": {**config["algorithm"], "hidden_size": [8]}}))
    with pytest.raises(odaf.CheckpointError, match=r"config\.json: algorithm: .*hidden_size"):
        training.load_run(run.path).policy(0)
    path.write_text(json.dumps({name: value for name, value in config.items() if name != "seeds"}))
    with pytest.raises(odaf.CheckpointError, match=r"config\.json: seeds: is missing"):
        training.load_run(run.path)
