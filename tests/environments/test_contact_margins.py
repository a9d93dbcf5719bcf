"""The two rules for contact margins: the older one's numbers, who is told, and what is recorded."""

import warnings

import gymnasium
import numpy as np
import pytest

from odaf.cli import main
from odaf.environments import contact_margins, locomotion_data, make, stitch_data
from odaf.environments.contact_margins import (
    apply,
    in_words,
    installed_rule,
    recorded,
    rule_of,
    simulator_of,
    warn_if_other,
)
from odaf.environments.locomotion import TASKS, Simulator
from odaf.environments.maze import STITCH
from odaf.environments.point_maze import _compiled
from odaf.environments.stitch_config import CONFIGS
from odaf.errors import ConfigError, OdafWarning
from odaf.evaluation import Rollouts

# Recorded with MuJoCo 3.3.7, which counts the larger margin (gymnasium 1.2.2, gymnasium-robotics 1.4.2): qpos, qvel
# of Hopper-v4 after 60 steps from seed 0 with the actions of default_rng(0).uniform(-1, 1, 3) each, and those of a
# point in a room of two cells, driven for 200 steps by clip(default_rng(0).normal(2) + [1, 0.6], -1, 1) from (-0.5, 0).
HOPPER = [
    -0.06451269133232208, 1.2091069844518578, -0.3422023556515799, -0.31598651457614674, -0.07564496189644074,
    0.19131027316040058, 0.488263809972764, 0.014241371550370495, 3.6021395112862207, 4.0117746494370845,
    -0.24776937687874104, -0.7953735297228746,
]  # fmt: skip
POINT = [0.898602872703903, 0.3985548895105095, 0.0022556959586808407, 0.13076251430917363]


def hopped(rule) -> np.ndarray:
    simulator, rng = Simulator(TASKS["hopper"], contact_margins=rule), np.random.default_rng(0)
    simulator.reset(0)
    for _ in range(60):
        simulator.step(rng.uniform(-1, 1, 3))
    return simulator.body()


def pushed(rule) -> np.ndarray:
    import mujoco

    model = _compiled(("1111", "1001", "1111"), rule)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)  # type: ignore[attr-defined]
    data.qpos[:] = [-0.5, 0.0]
    mujoco.mj_forward(model, data)  # type: ignore[attr-defined]
    for _ in range(200):
        data.ctrl[:] = np.clip(rng.normal(size=2) + [1.0, 0.6], -1, 1)
        mujoco.mj_step(model, data)  # type: ignore[attr-defined]
    return np.concatenate([data.qpos, data.qvel])


def test_the_larger_margin_is_what_the_older_simulator_counted():
    np.testing.assert_allclose(hopped("larger"), HOPPER, rtol=0, atol=1e-12)
    np.testing.assert_allclose(pushed("larger"), POINT, rtol=0, atol=1e-12)
    assert installed_rule() == "added"
    assert np.abs(hopped("added") - HOPPER).max() > 0.01 and np.abs(pushed("added") - POINT).max() > 1e-3
    np.testing.assert_array_equal(hopped(None), hopped("added"))  # who says nothing gets the installed rule
    np.testing.assert_array_equal(pushed(None), pushed("added"))


def test_an_older_simulator_is_brought_to_the_newer_rule(monkeypatch):
    environment = make({"name": "gymnasium", "id": "Hopper-v4"})()
    before = contact_margins.models_in(environment)[0].geom_margin.copy()
    monkeypatch.setattr(contact_margins, "installed_version", lambda: "3.4.0")
    apply(environment, "larger", "Hopper-v4")
    np.testing.assert_array_equal(contact_margins.models_in(environment)[0].geom_margin, before)
    apply(environment, "added", "Hopper-v4")
    np.testing.assert_array_equal(contact_margins.models_in(environment)[0].geom_margin, 2 * before)


def test_environments_are_made_by_either_rule_and_say_so():
    for description in ({"name": "gymnasium", "id": "Hopper-v5"}, {"name": "pointmaze", "maze": STITCH.to_dict()}):
        for rule in ("added", "larger"):
            one, other = make(description, rule)(), make({**description, "contact_margins": rule})()
            margins = [contact_margins.models_in(environment)[0].geom_margin for environment in (one, other)]
            np.testing.assert_array_equal(*margins)
            assert simulator_of(one, rule) == {"mujoco": contact_margins.installed_version(), "contact_margins": rule}
    plain = make({"name": "gymnasium", "id": "HalfCheetah-v5"})()
    assert simulator_of(plain) == {"mujoco": contact_margins.installed_version(), "contact_margins": "none"}
    assert simulator_of(gymnasium.make("Pendulum-v1")) is None
    with pytest.raises(ConfigError, match="'Pendulum-v1' has no MuJoCo model; leave the option out"):
        make({"name": "gymnasium", "id": "Pendulum-v1"}, "larger")()
    with pytest.raises(ConfigError, match="contact_margins='both': give 'added' .* or 'larger'"):
        make({"name": "gymnasium", "id": "Hopper-v5", "contact_margins": "both"})


def test_the_mazes_of_gymnasium_robotics_have_their_margins_halved_too():
    for name in ("PointMaze_UMaze-v3", "AntMaze_UMaze-v5"):
        one, other = (make({"name": "gymnasium", "id": name}, rule)() for rule in ("added", "larger"))
        margins = [contact_margins.models_in(environment)[0].geom_margin for environment in (one, other)]
        assert margins[0].max() > 0 and len(contact_margins.models_in(one)) == 1
        np.testing.assert_array_equal(margins[1], 0.5 * margins[0])


def test_bodies_that_the_installed_simulator_cannot_make_name_the_versions_that_work():
    for name in ("FetchReach-v4", "HandReach-v3", "FrankaKitchen-v1"):
        with pytest.raises(ConfigError, match=rf"'{name}'.*MuJoCo 3.12 and newer.*pip install \"mujoco<3\.12\""):
            make({"name": "gymnasium", "id": name})()


@pytest.mark.parametrize(
    ("version", "rule"),
    [
        ("3.4.0", "larger"),
        ("3.5.0", "added"),
        ("2.3.7", "larger"),
        ("4.0.0", "added"),
        ("3.10.1", "added"),
        ("x", None),
    ],
)
def test_rule_of_a_version(version, rule):
    assert rule_of(version) == rule


def test_what_data_say_of_their_simulator():
    assert recorded({"versions": {"mujoco": "3.3.7"}}) == {"mujoco": "3.3.7", "contact_margins": "larger"}
    chosen = {"versions": {"mujoco": "4.0.0"}, "environment": {"contact_margins": "larger"}}
    assert recorded(chosen) == {"mujoco": "4.0.0", "contact_margins": "larger"}
    assert recorded({"minari": {"requirements": ["mujoco==3.2.3", "x"]}}) == {
        "mujoco": "3.2.3",
        "contact_margins": "larger",
    }
    assert recorded({"minari": {"requirements": ["mujoco>=3.2.3"]}}) is None
    published = recorded({"format": "d4rl", "file": "hopper_medium-v2.hdf5"})
    assert published is not None and published["contact_margins"] == "larger" and published["likely"]
    assert recorded({"format": "d4rl", "file": "hopper.h5"}) is None and recorded({}) is None
    assert in_words(published) == "MuJoCo of unknown version, the larger contact margin counted"


def test_generated_data_record_a_rule_that_was_asked_for_and_nothing_else_changes():
    plain = locomotion_data.generate("hopper-random", 60)
    assert "contact_margins" not in plain.provenance["versions"] | plain.provenance["environment"]
    older = locomotion_data.generate("hopper-random", 60, contact_margins="larger")
    assert older.provenance["versions"]["contact_margins"] == "larger"
    assert older.environment == {**(plain.environment or {}), "contact_margins": "larger"}
    assert not np.array_equal(older.next_observations, plain.next_observations)
    config = CONFIGS["stitch"].with_repeats(1)
    maze = stitch_data.generate(config, contact_margins="larger")
    assert maze.environment is not None and maze.environment["contact_margins"] == "larger"
    assert not np.array_equal(maze.observations, stitch_data.generate(config).observations)


def test_evaluation_plays_by_the_rule_of_the_data_unless_another_is_given():
    own = {"name": "gymnasium", "id": "Hopper-v4", "kwargs": {}, "contact_margins": "larger"}
    assert Rollouts().resolved(own).environment == own
    given = Rollouts(contact_margins="added").resolved(own)
    assert given.environment == {**own, "contact_margins": "added"} and Rollouts.from_dict(given.to_dict()) == given
    assert "contact_margins" not in Rollouts("Hopper-v4").resolved(None).to_dict()["environment"]


def test_other_sides_are_told_where_the_body_has_margins():
    old, new = {"mujoco": "3.3.7", "contact_margins": "larger"}, {"mujoco": "4.0.0", "contact_margins": "added"}
    with pytest.warns(
        OdafWarning, match=r"recorded under MuJoCo 3.3.7, .*the body is another .*contact_margins=\"larger"
    ):
        warn_if_other(old, new)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not warn_if_other(old, {**new, "contact_margins": "none"})
        assert not warn_if_other(old, {**new, "contact_margins": "larger"})
        assert not warn_if_other(None, new) and not warn_if_other(old, None)


def test_the_command_line_records_shows_and_warns(tmp_path, capsys):
    """From the record to the score: the rule stands in the data, beside the score and in the warning."""
    data, run = tmp_path / "hop.h5", tmp_path / "run"
    small = ["--transitions", "300", "--out", str(data)]
    assert main(["data", "generate", "hopper-random", *small, "--contact-margins", "larger"]) == 0
    assert main(["data", "info", str(data)]) == 0
    assert "the larger contact margin counted" in capsys.readouterr().out
    words = ["--data", str(data), "--out", str(run), "--steps", "4", "--episodes", "1", "--quiet"]
    assert main(["train", "behaviour-cloning", *words, "--batch-size", "32"]) == 0
    said = capsys.readouterr()
    assert "the larger contact margin counted" in said.out and "warning" not in said.err
    words = [str(run), "--episodes", "1", "--json", str(tmp_path / "scores.json")]
    with warnings.catch_warnings():
        warnings.simplefilter("always", OdafWarning)
        assert main(["evaluate", *words, "--contact-margins", "added"]) == 0
    said = capsys.readouterr()
    assert (
        "contact margins added" in said.out and '"contact_margins": "added"' in (tmp_path / "scores.json").read_text()
    )
    assert "odaf evaluate: warning: the data were recorded under MuJoCo" in said.err
    assert "pass --contact-margins larger" in said.err and "OdafWarning" not in said.err
