"""The ant of the mazes beside gymnasium's, walls that hold, and episodes as D4RL plays them."""

import pickle
import warnings
from pathlib import Path

import gymnasium
import gymnasium.envs.mujoco
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from odaf.environments import contact_margins, make
from odaf.environments.ant_maze import AntMaze
from odaf.environments.contact_margins import simulator_of
from odaf.environments.registry import make_untimed
from odaf.errors import ConfigError

IDS = {"odaf/AntMaze-UMaze-v0": 700, "odaf/AntMaze-Medium-v0": 1000, "odaf/AntMaze-Large-v0": 1000}
LYING = np.array([0.0, 0.0, 0.3, 0.0, 1.0, 0.0, 0.0, *[0.0, 1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0]])  # on its back
STILL = np.zeros(8)


@pytest.fixture(scope="module")
def ant() -> AntMaze:
    return AntMaze("umaze")


def test_the_model_is_gymnasiums_but_for_step_motors_and_contacts():
    theirs = Path(gymnasium.envs.mujoco.__file__).parent / "assets" / "ant.xml"
    plain = mujoco.MjModel.from_xml_path(str(theirs))  # type: ignore[attr-defined]
    ours = AntMaze("umaze", contact_margins="added").model
    names = [ours.geom(index).name for index in range(ours.ngeom)]
    kept = [index for index, name in enumerate(names) if not name.startswith("block_")]
    assert [names[index] for index in kept] == [plain.geom(index).name for index in range(plain.ngeom)]
    families = ("body_", "jnt_", "dof_", "geom_", "actuator_", "qpos", "site_", "tendon_", "eq_", "exclude_", "pair_")
    # Addresses and search trees in the longer list of geoms.
    lists = {"body_geomadr", "body_geomnum", "body_bvhadr", "body_bvhnum"}
    differing = set()
    for name in (name for name in dir(plain) if name.startswith(families) and name not in lists):
        one, other = getattr(plain, name), getattr(ours, name)
        if isinstance(one, np.ndarray):
            other = other[kept] if name.startswith("geom_") else other
            differing |= set() if np.array_equal(one, other) else {name}
    # acc0 is the acceleration that one unit of control gives, so it follows from gear.
    assert differing == {"geom_solimp", "actuator_gear", "actuator_ctrlrange", "actuator_acc0"}
    # What D4RL writes for solref is what MuJoCo takes where nothing is written.
    np.testing.assert_array_equal(ours.geom_solref[kept], np.tile([0.02, 1.0], (len(kept), 1)))
    np.testing.assert_array_equal(ours.geom_solimp[kept][:, :3], np.tile([0.8, 0.8, 0.01], (len(kept), 1)))
    np.testing.assert_array_equal(ours.actuator_ctrlrange, np.tile([-30.0, 30.0], (8, 1)))
    np.testing.assert_array_equal(ours.actuator_gear[:, 0], np.ones(8))
    fields = [name for name in dir(plain.opt) if not name.startswith("_")]
    differing = {name for name in fields if not np.array_equal(getattr(plain.opt, name), getattr(ours.opt, name))}
    assert differing == {"timestep"} and ours.opt.timestep == 0.02


def test_a_box_stands_on_every_wall_and_nowhere_else(ant: AntMaze):
    model = ant.model
    boxes = [model.geom(index) for index in range(model.ngeom) if model.geom(index).name.startswith("block_")]
    assert len(boxes) == 25 - 7
    places = {box.name: tuple(box.pos) for box in boxes}
    assert places["block_0_0"] == (-4.0, -4.0, 1.0) and places["block_2_2"] == (4.0, 4.0, 1.0)
    assert places["block_4_1"] == (0.0, 12.0, 1.0) and "block_2_3" not in places
    assert all(tuple(box.size) == (2.0, 2.0, 1.0) for box in boxes)


@pytest.mark.parametrize("rule", ["larger", "added"])
def test_walls_hold_an_ant_that_is_thrown_at_them(rule):
    ant = AntMaze(["11111", "100r1", "11111"], contact_margins=rule)
    ant.reset(seed=0)
    reached = {}
    for side, speed in (("wall", 8.0), ("way", -8.0)):
        qvel = np.zeros(14)
        qvel[0] = speed
        ant.place(ant.model.qpos0, qvel)
        reached[side] = [float(ant.step(STILL)[0][0]) for _ in range(12)]
    # The wall's face is at 2 m; the other way is free, and its walls end the run at -10 m.
    assert max(reached["wall"]) > 0.5 and max(reached["wall"]) < 2.0
    assert -9.8 < min(reached["way"]) < -2.5


@pytest.mark.parametrize(("name", "left", "top"), [("umaze", 0.0, 8.0), ("medium", 20.0, 20.0), ("large", 32.0, 24.0)])
def test_goals_are_drawn_anew_where_d4rl_draws_them(name, left, top):
    ant = AntMaze(name)
    goals = np.array([ant.reset(seed=0 if index == 0 else None)[1]["goal"] for index in range(300)])
    offsets = goals - [left, top]
    assert offsets.min() >= 0.0 and offsets.max() <= 1.5 and len(np.unique(goals, axis=0)) == 300
    assert offsets.min() < 0.1 and offsets.max() > 1.4
    # A uniform number up to 1 and one up to 0.5: mean 0.75, variance (1 + 0.25) / 12; the limits are 4 standard errors.
    assert np.abs(offsets.mean(axis=0) - 0.75).max() < 4 * np.sqrt(1.25 / 12 / 300)
    assert np.abs(offsets.var(axis=0) - 1.25 / 12).max() < 0.03


def test_starts_have_the_noise_of_d4rl_and_a_seed_fixes_them():
    ant = AntMaze("umaze")
    first = ant.reset(seed=3)
    again = ant.reset(seed=3)
    np.testing.assert_array_equal(first[0], again[0])
    np.testing.assert_array_equal(first[1]["goal"], again[1]["goal"])
    assert not np.array_equal(first[0], ant.reset()[0])
    starts = np.array([ant.reset()[0] for _ in range(300)])
    others = [0, 1, 2, *range(7, 15)]
    noise = starts[:, others] - ant.model.qpos0[others]
    assert 0.095 < np.abs(noise).max() <= 0.1 and noise.min() < -0.09
    np.testing.assert_allclose(np.linalg.norm(starts[:, 3:7], axis=1), 1.0, rtol=1e-12)
    assert 0.095 < starts[:, 15:].std() < 0.105


def test_random_starts_and_goals_without_marks_are_all_over_the_maze():
    ant = AntMaze("medium-play", mode="collection", random_start=True)
    drawn = [ant.reset(seed=0 if index == 0 else None) for index in range(400)]
    starts = np.array([observation[:2] for observation, _ in drawn])
    goals = {ant.maze.cell((float(info["goal"][0]), float(info["goal"][1]))) for _, info in drawn}
    marked = {(2, 6), (5, 1), (6, 5)}
    assert goals == marked
    inside = starts % 4.0
    assert inside.max() <= 1.0 and inside.min() < 0.05 and inside.max() > 0.95
    assert {ant.maze.cell((float(x), float(y))) for x, y in starts} == set(ant.maze.free) - marked
    anywhere = AntMaze("umaze-diverse")
    centres = {anywhere.maze.cell(tuple(anywhere.reset()[1]["goal"])) for _ in range(100)}
    assert centres == set(anywhere.maze.free)


def test_a_start_and_a_goal_may_be_chosen_for_one_episode(ant: AntMaze):
    observation, info = ant.reset(seed=0, options={"start": (3, 3), "goal": [1, 2]})
    assert ant.maze.cell((observation[0], observation[1])) == (3, 3)
    assert ant.maze.cell(tuple(info["goal"])) == (1, 2)
    with pytest.raises(ConfigError, match=r"ant maze 'umaze': goal \(2, 2\) is no free cell .*free are \(\(1, 1\), "):
        ant.reset(options={"goal": (2, 2)})


@pytest.mark.parametrize(("mode", "ends"), [("evaluation", True), ("collection", False)])
def test_the_goal_pays_one_and_ends_an_episode_only_in_evaluation(mode, ends):
    ant = AntMaze("umaze", mode=mode)
    ant.reset(seed=0)
    for apart, paid in ((0.4, 1.0), (0.6, 0.0), (0.4, 1.0)):
        qpos = ant.model.qpos0.copy()
        qpos[:2] = ant.goal[0] + apart, ant.goal[1]
        ant.place(qpos, np.zeros(14))
        _, reward, terminated, truncated, info = ant.step(STILL)
        assert (reward, info["success"]) == (paid, paid == 1.0)
        assert (terminated, truncated) == (ends and paid == 1.0, False)


def test_a_fall_ends_nothing(ant: AntMaze):
    observation = ant.reset(seed=0)[0]
    ant.place(LYING, np.zeros(14))
    for _ in range(15):
        observation, reward, terminated, truncated, _ = ant.step(STILL)
        assert (reward, terminated, truncated) == (0.0, False, False)
    w, x, y, z = observation[3:7]
    assert w * w - x * x - y * y + z * z < -0.5  # the torso's upward axis still points down


def test_observations_torques_and_time(ant: AntMaze):
    ant.reset(seed=0)
    assert ant.data.time == 0.0
    observation, _, _, _, info = ant.step(np.linspace(-1.0, 1.0, 8))
    assert ant.data.time == pytest.approx(0.1)
    np.testing.assert_allclose(ant.data.actuator_force, np.linspace(-30.0, 30.0, 8))
    assert observation.dtype == np.float64
    np.testing.assert_array_equal(observation[:15], ant.data.qpos)
    np.testing.assert_array_equal(observation[15:], ant.data.qvel)
    np.testing.assert_array_equal(np.concatenate([info["qpos"], info["qvel"]]), observation)
    ant.step(np.full(8, 7.0))
    np.testing.assert_array_equal(ant.data.actuator_force, np.full(8, 30.0))
    ant.step(np.array([np.nan, *[1.0] * 7]))
    np.testing.assert_array_equal(ant.data.actuator_force, np.zeros(8))


@pytest.mark.parametrize(("identity", "limit"), IDS.items())
def test_registered_ids_have_the_limits_of_d4rl_and_pass_the_checker(identity, limit):
    build, steps = make_untimed({"name": "gymnasium", "id": identity})
    assert steps == limit == gymnasium.spec(identity).max_episode_steps
    ant = build().unwrapped
    assert isinstance(ant, AntMaze) and ant.mode == "evaluation"
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*A Box observation space m")  # positions have no bounds
        check_env(ant)
    short = make({"name": "gymnasium", "id": identity, "max_episode_steps": 2})()
    short.reset(seed=0)
    assert [short.step(STILL)[3] for _ in range(2)] == [False, True]


def test_settings_are_json_and_pickled_environments_start_alike():
    description = {"name": "gymnasium", "id": "odaf/AntMaze-v0", "kwargs": {"maze": ["11111", "1r0g1", "11111"]}}
    environment = make(description)().unwrapped
    assert isinstance(environment, AntMaze)
    other = pickle.loads(pickle.dumps(environment))
    assert other.maze == environment.maze and other.maze.goals == ((1, 3),)
    for one in (environment, other):
        one.reset(seed=4)
    np.testing.assert_array_equal(environment.step(STILL)[0], other.step(STILL)[0])
    with pytest.raises(ConfigError, match="ant maze: mode is 'training'; give 'evaluation' or 'collection'"):
        AntMaze("umaze", mode="training")


def test_margins_are_those_of_the_public_data_unless_another_rule_is_asked_for():
    def margins(rule=None, **kwargs):
        description = {"name": "gymnasium", "id": "odaf/AntMaze-UMaze-v0", "kwargs": kwargs}
        environment = make(description, rule)()
        (model,) = contact_margins.models_in(environment)
        assert len(set(model.geom_margin)) == 1
        simulator = simulator_of(environment, rule)
        assert simulator is not None
        return float(model.geom_margin[0]), simulator["contact_margins"]

    assert contact_margins.installed_rule() == "added"
    assert margins() == (0.005, "larger")
    assert margins("added") == (0.01, "added")
    assert margins("larger") == (0.005, "larger")  # not halved twice
    assert margins("larger", contact_margins="added") == (0.005, "larger")
    assert margins(contact_margins=None) == (0.01, "added")
    with pytest.raises(ConfigError, match="contact_margins='both'"):
        AntMaze("umaze", contact_margins="both")
