"""`odaf.export`: all forms do what the policy does, within bounds and limits, and refuse what they should."""

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import odaf
from golden.deployed import HIGH, LOW, OnnxPolicy, asking, policy_of, remembering
from golden.runs import dataset_of, untrained_run
from odaf.components import policies as actors
from odaf.components.ranked_actors import RankedGaussianActor
from odaf.data.derived import Derivation
from odaf.deployment import check, odaf_policy
from odaf.deployment.policies import bounds_inside, policy_program, with_formulas_outside
from odaf.errors import ConfigError, DatasetError, OdafWarning

needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
LIMITS = {"valve": 0.05, "heat": 4.0}


@needs_cc
@pytest.mark.parametrize("kind", ["behaviour-cloning", "ensemble-sac", "iql", "bcq", "bear"])
def test_all_forms_of_every_kind_of_actor_do_what_the_policy_does(kind, tmp_path):
    artefact = odaf.export(policy_of(kind), tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {*artefact.contract["files"], "contract.json"}
    for file in ("policy.safetensors", "policy.onnx", "policy.h"):
        found = artefact.contract["checked"][file]
        assert found["checked"] and found["steps"] == 320 and found["largest_difference"] <= 1e-5
        assert found["left_to_rounding"] < 64, "most actions are told by single precision"


@needs_cc
def test_memory_and_limits_are_in_all_forms(tmp_path):
    artefact = odaf.export(
        policy_of("behaviour-cloning", derivation=remembering()), tmp_path, replace=True, max_change=LIMITS
    )
    for found in artefact.contract["checked"].values():
        assert found["steps"] > 250 and found["largest_difference"] <= 1e-5
    assert artefact.contract["steps_before_the_first_action"] == 2


@needs_cc
def test_a_policy_that_is_asked_for_a_return_is_told_what_it_earns_in_all_forms(tmp_path):
    artefact = odaf.export(asking(remembering()), tmp_path, replace=True, max_change=LIMITS)
    for found in artefact.contract["checked"].values():
        assert found["steps"] > 250 and found["largest_difference"] <= 1e-5
    assert [entry["name"] for entry in artefact.contract["observation"]] == ["level", "flow", "temp", "last_reward"]
    assert "0 in the first step" in artefact.contract["observation"][-1]["meaning"]


def test_what_was_earned_counts_once_and_not_in_a_step_that_is_refused(tmp_path):
    policy = asking()
    odaf.export(policy, tmp_path / "out", forms=["numpy", "onnx"])
    numpy, graph = (
        odaf_policy.Policy(tmp_path / "out" / "policy.safetensors"),
        OnnxPolicy(tmp_path / "out" / "policy.onnx"),
    )
    rng, carry, earned = np.random.default_rng(0), policy.begin(), 0.0
    low, high = (np.asarray(bound) for bound in (LOW, HIGH))
    for step in range(6):
        row = dict(zip(policy.observation_names, rng.normal(size=4).astype(np.float32), strict=True))
        reward = 0.0 if step == 0 else 4.0 * rng.normal()
        earned += reward
        carry = policy.observe(carry, reward)
        expected, carry = policy.act(carry, row)
        if step == 3:
            for wrong in ({**row, "x2": np.nan, "last_reward": reward}, {**row, "last_reward": np.inf}):
                with pytest.raises(odaf_policy.Refused, match="is not a finite number"):
                    numpy.act(wrong)
                assert graph.act(list(wrong.values()))[1] == 1
        given = {**row, "last_reward": reward}
        for action in (numpy.act(given), graph.act(list(given.values()))[0]):
            assert action is not None
            np.testing.assert_allclose((action - expected) / (high - low), 0.0, atol=1e-5)
        np.testing.assert_allclose(numpy._carry["return_to_go"].item(), 30.0 - earned, rtol=1e-5)
        np.testing.assert_allclose(graph.carry["return_to_go"].item(), 30.0 - earned, rtol=1e-5)
    with pytest.raises(odaf_policy.Refused, match=r"missing \['last_reward'\]"):
        numpy.act(dict.fromkeys(policy.observation_names, 0.0))
    numpy.begin()
    assert numpy._carry["return_to_go"].item() == 30.0


def test_no_reading_may_have_the_name_of_the_reward(tmp_path):
    policy = replace(asking(), observation_names=("x0", "x1", "x2", "last_reward"))
    with pytest.raises(ConfigError, match="last_reward: is a reading of this policy"):
        odaf.export(policy, tmp_path / "out")


@needs_cc
@pytest.mark.parametrize("kind", ["behaviour-cloning"])
def test_the_shipped_test_of_c_notices_another_weight(kind, tmp_path):
    odaf.export(policy_of(kind), tmp_path / "out", forms=["c"])
    header = tmp_path / "out" / "policy.h"
    text = header.read_text()
    place = text.index("{", text.index("biases/2"))
    header.write_text(text[:place] + "{ 0.25f +" + text[place + 1 :])
    with pytest.raises(ConfigError, match="policy_test.c: test fails .*expected"):
        check.run_c_test(tmp_path / "out" / "policy_test.c", "cc", tmp_path)


@needs_cc
@pytest.mark.parametrize("kind", ["ensemble-sac", "bcq"])
def test_absurd_readings_give_an_action_within_bounds_or_none(kind, tmp_path):
    odaf.export(policy_of(kind), tmp_path / "out")
    rng = np.random.default_rng(0)
    rows = (10.0 ** rng.uniform(6, 38.4, (300, 1, 4)) * rng.choice([-1, 1], (300, 1, 4))).clip(-3e38, 3e38)
    trials = check.Trials(rows.astype(np.float32), np.full((300, 1, 2), np.nan, np.float32))
    for runner in (
        check.numpy_runner(tmp_path / "out" / "policy.safetensors"),
        check.onnx_runner(tmp_path / "out" / "policy.onnx"),
        check.c_runner(tmp_path / "out" / "policy.h", "cc", tmp_path),
    ):
        actions, status = runner(trials)
        assert np.isnan(actions[status != 0]).all()
        taken = actions[status == 0].astype(np.float64)
        assert len(taken) > 100 and (taken >= LOW).all() and (taken <= HIGH).all()
        assert np.abs(taken.max(axis=0) - HIGH).max() < 1e-4, "a bound is reached"


def test_bounds_are_rounded_to_the_inside():
    low, high = bounds_inside(replace(policy_of("behaviour-cloning"), action_low=(-0.3, 0.1), action_high=(0.3, 100.0)))
    assert (low.astype(np.float64) >= [-0.3, 0.1]).all() and (high.astype(np.float64) <= [0.3, 100.0]).all()
    assert float(np.float32(0.3)) > 0.3, "else this shows nothing"


@pytest.fixture(scope="module")
def limited(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy with earlier rows and a limit on one of two actions."""
    folder = tmp_path_factory.mktemp("limited") / "out"
    policy = policy_of("behaviour-cloning", derivation=remembering(1, False))
    odaf.export(policy, folder, forms=["numpy", "onnx"], max_change={"valve": 0.05})
    return folder


def test_a_limit_holds_from_what_was_played_and_a_refused_reading_changes_nothing(limited: Path):
    numpy, graph = odaf_policy.Policy(limited / "policy.safetensors"), OnnxPolicy(limited / "policy.onnx")
    rng, last = np.random.default_rng(0), np.array([-0.2, 40.0], np.float32)
    numpy.act(rng.normal(size=3))
    assert graph.act(rng.normal(size=3))[1] == 2, "nothing is known of the step before"
    for policy in (numpy, graph):
        if isinstance(policy, OnnxPolicy):
            policy.carry["actions_before"][0, :2] = last
        else:
            policy.acted(last)
    numpy._carry["observations_before"] = graph.carry["observations_before"].reshape(1, 1, -1).copy()
    jumps = []
    for step in range(20):
        row = rng.normal(size=3).astype(np.float32)
        if step % 3 == 1:
            before = {name: value.copy() for name, value in graph.carry.items()}
            action, status = graph.act([np.nan, *row[1:]])
            assert status == 1 and np.isnan(action).all()
            np.testing.assert_equal(graph.carry, before)
            with pytest.raises(odaf_policy.Refused, match="observation: level is not a finite number"):
                numpy.act([np.nan, *row[1:]])
            assert np.isnan(numpy.run({"observation": [np.nan, *row[1:]]})["action"]).all()
        action, (other, status) = numpy.act(row), graph.act(row)
        assert action is not None and status == 0
        np.testing.assert_allclose(action, other, atol=2e-3)  # of 100; what was played goes in again
        assert abs(action[0] - last[0]) <= 0.05 * (1 + 1e-6)
        jumps.append(abs(action[1] - last[1]))
        last = action
    assert max(jumps) > 1.0, "the other action is free"


def test_the_graph_refuses_what_is_not_finite_row_by_row(limited: Path, tmp_path):
    odaf.export(policy_of("bear"), tmp_path / "out", forms=["onnx"])
    graph = OnnxPolicy(tmp_path / "out" / "policy.onnx")
    rows = np.random.default_rng(0).normal(size=(9, 4)).astype(np.float32)
    alone = graph.run({"observation": rows})["action"]
    for wrong in (np.nan, np.inf, -np.inf):
        for column in range(4):
            broken = rows.copy()
            broken[5, column] = wrong
            found = graph.run({"observation": broken})
            assert found["status"].tolist() == [0, 0, 0, 0, 0, 1, 0, 0, 0] and np.isnan(found["action"][5]).all()
            np.testing.assert_array_equal(np.delete(found["action"], 5, 0), np.delete(alone, 5, 0))


def test_the_graph_names_its_columns_and_refuses_others(tmp_path):
    odaf.export(policy_of("behaviour-cloning"), tmp_path / "out", forms=["onnx"], named_inputs=True)
    graph = OnnxPolicy(tmp_path / "out" / "policy.onnx")
    feeds = {f"x{index}": np.full((2, 1), 0.1 * index, np.float32) for index in range(4)}
    assert graph.run(feeds)["action"].shape == (2, 2)
    for wrong in ({**feeds, "y": feeds["x0"]}, {name: feeds[name] for name in list(feeds)[1:]}):
        with pytest.raises(Exception, match=r"Invalid input name: y|Required inputs \(\['x0'\]\) are missing"):
            graph.run(wrong)
    with pytest.raises(Exception, match="Unexpected input data type"):
        graph.run({**feeds, "x0": feeds["x0"].astype(np.float64)})


def test_metadata_of_the_graph_hold_names_units_and_bounds(limited: Path):
    metadata = OnnxPolicy(limited / "policy.onnx").metadata
    assert json.loads(metadata["inputs"])[0]["columns"] == ["level", "flow", "temp"]
    assert json.loads(metadata["outputs"])[0]["units"] == ["", "%"]
    assert json.loads(metadata["bounds"]) == {"low": list(LOW), "high": list(HIGH)}
    assert json.loads(metadata["max_change"]) == {"valve": 0.05}


def test_a_form_that_does_something_else_is_not_written(tmp_path, monkeypatch):
    program = policy_program(policy_of("behaviour-cloning"))
    bent = {**program.constants, "actions/half": 1.001 * program.constants["actions/half"]}
    monkeypatch.setattr("odaf.deployment.artefact.policy_program", lambda *_: replace(program, constants=bent))
    with pytest.raises(ConfigError, match=r"policy.safetensors: gives (valve|heat) = .* where the policy gives"):
        odaf.export(policy_of("behaviour-cloning"), tmp_path / "out", forms=["numpy"])
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_written_is_refused_by_name(tmp_path):
    policy = policy_of("behaviour-cloning")
    formulas = Derivation.from_recipes([{"recipe": "expression", "name": "error", "expression": "level - setpoint"}])
    computing = policy_of("behaviour-cloning", derivation=replace(formulas, parts=(*formulas.parts, ("flow", None))))
    diverged = replace(policy, actor=_with_bias(policy.actor, jnp.nan))
    for wrong, options, said in (
        (policy, {"max_change": {"pump": 1.0}}, "max_change: 'pump' is no action; there are valve, heat"),
        (policy, {"max_change": {"valve": 0.0}}, "must be a finite number above 0"),
        (policy, {"forms": []}, "forms: none is no form; there are numpy, onnx, c"),
        (computing, {}, "derivation: 'error = level - setpoint' is a formula"),
        (diverged, {}, "holds numbers that are not finite, because training diverged"),
        (replace(policy, actor=_Unknown()), {}, "_Unknown: no description of how it acts"),
        (policy, {"step": 3}, "choose a policy of a run"),
        (tmp_path / "nothing", {}, "there is no such file"),
    ):
        with pytest.raises(odaf.OdafError, match=said):
            odaf.export(wrong, tmp_path / "out", **{"forms": ["numpy"], **options})
    found = odaf.export(computing, tmp_path / "out", forms=["numpy"], formulas_outside=True)
    assert found.contract["observation"][0]["formula"] == "level - setpoint"
    assert with_formulas_outside(computing).reading_names == ("error", "flow")
    with pytest.raises(ConfigError, match="exists already"):
        odaf.export(policy, tmp_path / "out", forms=["numpy"])


class _Unknown(actors.Actor):
    def act(self, carry, observations, key=None):
        del key
        return observations[:, :2], carry


def _with_bias(actor, value: float):
    network = actor.network
    biases = (*network.biases[:-1], jnp.full_like(network.biases[-1], value))
    return type(actor)(type(network)(network.weights, biases, (), (), network.activation))


def test_without_a_compiler_c_is_written_and_said_to_be_unchecked(tmp_path, monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.warns(OdafWarning, match="policy.h: not checked: no C compiler"):
        found = odaf.export(policy_of("behaviour-cloning"), tmp_path / "out", forms=["c"])
    assert "not checked" in str(found) and (tmp_path / "out" / "policy_test.c").exists()


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ConfigError, match=r"pip install 'odaf\[export\]'.*forms=\['numpy', 'c'\]"):
        odaf.export(policy_of("behaviour-cloning"), tmp_path / "out")


def test_the_contract_says_what_the_log_has_shown_and_which_checkpoint_it_is(tmp_path):
    log = dataset_of(3, 2, {"id": "Hopper-v4"})
    run = untrained_run(tmp_path / "run", odaf.BehaviourCloning(hidden_sizes=(4,)), log)
    found = odaf.export(run, tmp_path / "out", forms=["numpy"], training_seed=1).contract
    header = json.loads((run / "seed-1" / "checkpoints" / "00000000" / "header.json").read_text())
    assert found["checkpoint_sha256"] == header["sha256"] and found["provenance"]["seed"] == 1
    jumps = np.abs(np.diff(log.actions.reshape(4, 10, 2), axis=1)).max(axis=(0, 1))
    np.testing.assert_allclose([entry["largest_logged_change"] for entry in found["action"]], jumps)
    np.testing.assert_allclose([entry["logged_high"] for entry in found["observation"]], log.observations.max(axis=0))
    assert found == json.loads((tmp_path / "out" / "contract.json").read_text())
    policy = odaf.load_run(run).policy(0)
    assert odaf.export(policy, tmp_path / "b", forms=["numpy"]).contract["observation"][0]["logged_low"] is None
    again = odaf.export(policy, tmp_path / "c", forms=["numpy"], data=log).contract
    assert again["observation"] == found["observation"]
    with pytest.raises(DatasetError, match="data: has the observations"):
        odaf.export(policy, tmp_path / "d", forms=["numpy"], data=dataset_of(4, 2, {}))


def test_the_runner_needs_numpy_alone(limited: Path):
    lines = Path(odaf_policy.__file__).read_text().splitlines()
    assert len(lines) <= 200
    code = (
        "import sys; from odaf_policy import Policy; policy = Policy('policy.safetensors'); "
        "policy.act({'flow': 1, 'temp': 2, 'level': 3}); policy.acted([0, 50]); "
        "print(policy.act({'flow': 1, 'temp': 2, 'level': 3})); "
        "assert not {'jax', 'odaf', 'scipy', 'onnx'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=limited, capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.startswith("["), done.stderr


def test_the_runner_converts_numbers_and_refuses_everything_else(limited: Path, tmp_path):
    policy = odaf_policy.Policy(limited / "policy.safetensors")
    row = np.array([0.5, -1.0, 2.0], np.float32)

    def act(given):
        policy.begin()
        policy.act(row)
        policy.acted([0.0, 50.0])
        return policy.act(given)

    wanted = act(row)
    by_name = dict(zip(policy.columns, row, strict=True))
    for given in (
        *(row.astype(kind) for kind in (">f4", ">f8", "<f8", np.float16, np.longdouble)),
        row.tolist(),
        row[None],
        by_name,
        {name: np.array([value], ">f4") for name, value in by_name.items()},
        np.ma.masked_array(row, [False] * 3),
    ):
        np.testing.assert_array_equal(act(given), wanted)
    np.testing.assert_array_equal(act(np.array([1, -1, 2], ">i2")), act([1.0, -1.0, 2.0]))
    for given, said in (
        ({**by_name, "pump": 1.0}, "missing none, unknown ['pump']; give exactly level, flow, temp"),
        ({"level": 1.0, "flow": 1.0}, "missing ['temp'], unknown none"),
        ({**by_name, "flow": "1.0"}, "observation: flow: '1.0' is no number"),
        ({**by_name, "flow": None}, "observation: flow: None is no number"),
        ({**by_name, "flow": [1.0, 2.0]}, "flow: holds 2 numbers, but takes one"),
        (row[:2], "holds 2 numbers, but takes 3"),
        (row.astype(complex), "is no number"),
        ([1e39, 0.0, 0.0], "level is not a finite number"),
        ([0.0, np.nan, 0.0], "flow is not a finite number"),
        (np.ma.masked_array(row, [False, True, False]), "flow is not a finite number"),
        ([[1.0], [1.0, 2.0]], "holds no numbers in a row"),
    ):
        with pytest.raises(odaf_policy.Refused) as error:
            act(given)
        assert said in str(error.value)
    np.testing.assert_array_equal(act(row), wanted)
    content = bytearray((limited / "policy.safetensors").read_bytes())
    content[-1] ^= 1
    for text, said in ((content, "was changed after it was written"), (b"no such file", "is damaged, or no file of")):
        (tmp_path / "other").write_bytes(text)
        with pytest.raises(odaf_policy.Refused, match=said):
            odaf_policy.Policy(tmp_path / "other")


@needs_cc
@pytest.mark.parametrize("command", ["cc", "c++"])
def test_names_of_every_kind_are_found_in_the_header(command, tmp_path):
    if shutil.which(command) is None:
        pytest.skip(f"needs {command}")
    names = ('flow "A" \\\\ */ ??/', "µ-Wert °C", "OBSERVATIONS", "line\nbreak")
    policy = replace(policy_of("behaviour-cloning"), observation_names=names, action_names=("double", "COLUMNS"))
    odaf.export(policy, tmp_path / "out", forms=["c"])
    listed = ", ".join('"' + "".join(f"\\{byte:03o}" for byte in name.encode()) + '"' for name in (*names, "pump"))
    source = tmp_path / ("main.c" if command == "cc" else "main.cpp")
    source.write_text(
        '#include <stdio.h>\n#include "policy.h"\nint main(void)\n{\n'
        f"    const char *names[] = {{{listed}}};\n"
        '    for (int k = 0; k < 5; ++k) printf("%d ", policy_observation_column(names[k]));\n'
        "    float obs[POLICY_OBSERVATIONS] = {0}, act[POLICY_ACTIONS];\n"
        '    printf("%d %d %d", policy_act(obs, act), POLICY_ACTION_double, POLICY_ACTION_COLUMNS);\n    return 0;\n}\n'
    )
    flags = ["-std=c99"] if command == "cc" else []
    words = [command, *flags, "-Wall", "-Wextra", "-pedantic", "-Werror", f"-I{tmp_path / 'out'}", source, "-lm"]
    subprocess.run([*words, "-o", tmp_path / "main"], check=True)
    done = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["0", "1", "2", "3", "-1", "0", "0", "1"]


@needs_cc
def test_a_candidate_that_rounding_alone_prefers_is_no_fault_of_a_form(tmp_path):
    """Two candidates are worth the same at every state: which one wins is up to the last bit of a sum."""
    policy = policy_of("bear")
    assert isinstance(policy.actor, RankedGaussianActor)
    twins = jnp.concatenate([policy.actor.noise[:1], policy.actor.noise[:1] + 1e-4])
    critic = policy.actor.critic
    flat = replace(critic, weights=(critic.weights[0].at[4:].multiply(1e-4), *critic.weights[1:]))
    artefact = odaf.export(replace(policy, actor=replace(policy.actor, noise=twins, critic=flat)), tmp_path / "out")
    assert any(found["left_to_rounding"] > 0 for found in artefact.contract["checked"].values())
