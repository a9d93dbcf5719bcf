"""The guard in all forms of the artefact: same actions, same alarms, and no reading deafens it."""

import dataclasses
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import odaf
from golden.deployed import OnnxPolicy, policy_of
from golden.tiny import filled
from odaf.components.critics import CriticEnsemble, init_critics
from odaf.components.dynamics import DynamicsConfig, untrained
from odaf.components.dynamics.deterministic import DeterministicDynamics
from odaf.components.policies import init_deterministic_actor
from odaf.components.priors import init_priors
from odaf.deployment import GuardedPolicy, odaf_policy
from odaf.deployment.conformal import Calibration
from odaf.deployment.guard import Reaction, judged
from odaf.deployment.guard_program import guarded_program
from odaf.deployment.odaf_policy import ALARM, FINE, NOT_FINITE, STOPPED
from odaf.deployment.safetensors_form import write_safetensors
from odaf.deployment.score import PARTS, GuardScore
from odaf.errors import ConfigError

needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
OBS, ACT = 4, 2
USUAL = np.array([0.1, 0.2, -0.1, 0.3], np.float32)


def guarded(reaction: Reaction, kind: str = "deterministic", actor: str = "behaviour-cloning", threshold: float = 1.0):
    """With random parameters; levels such that about half of the usual steps are alarms at a threshold of 1."""
    policy, rng = policy_of(actor), np.random.default_rng(1)
    keys = jax.random.split(jax.random.key(0), 4)
    model = untrained(DynamicsConfig(kind=kind, hidden_sizes=(5,), latent_dim=2, elites=2), keys[0], OBS, ACT)  # type: ignore
    model = filled(model, 3, 0.4)
    priors = init_priors(keys[1], OBS, ACT, (4,), 3, 0.5) if actor == "ensemble-sac" else None
    critics = CriticEnsemble(filled(init_critics(keys[2], OBS, ACT, (4,), 3, "layer", None), 4), priors)
    width = OBS + ACT
    white, error_white = (np.eye(n) + 0.1 * np.ones((n, n)) for n in (width, OBS))
    inverse = np.where(np.isin(np.arange(OBS), policy.normaliser.constant), 0.0, 1.0 / policy.normaliser.scale)
    numbers = {
        "mean": policy.normaliser.mean,
        "inverse_scale": inverse,
        "centre": rng.normal(size=OBS),
        "half_width": rng.uniform(1.0, 3.0, OBS),
        "whitening": white,
        "points": rng.normal(size=(9, width)),
        "error_whitening": error_white,
        "levels": [4.0, 6.0, 3.0, 12.0],
    }
    score = GuardScore(model, critics, **{name: jnp.asarray(x, jnp.float32) for name, x in numbers.items()})
    clone = filled(init_deterministic_actor(keys[3], OBS, ACT, (4,)), 5)
    facts = {"alarms": 0, "policy_alarms": 0, "alarms_by_part": dict.fromkeys(PARTS, 0), "critics": "", "dynamics": ""}
    calibration = Calibration(threshold, 0.05, 0.05, 19, None, 10)
    return GuardedPolicy(policy, score, calibration, reaction, clone, facts | {"notes": []})


def walk(steps: int, seed: int = 0) -> np.ndarray:
    return (USUAL + 0.8 * np.random.default_rng(seed).normal(size=(steps, OBS)).cumsum(axis=0)).astype(np.float32)


def numpy_form(made: GuardedPolicy, folder: Path) -> Any:
    write_safetensors(guarded_program(made), folder / "policy.safetensors")
    return odaf_policy.Policy(folder / "policy.safetensors")


@needs_cc
@pytest.mark.parametrize(
    ("reaction", "kind", "actor"),
    [
        ("warn", "deterministic", "behaviour-cloning"),
        ("hold", "ensemble", "ensemble-sac"),
        ("clone", "cvae", "bear"),
        ("stop", "deterministic", "bcq"),
    ],
)
def test_every_form_acts_and_alarms_as_the_guarded_policy(reaction, kind, actor, tmp_path: Path):
    """`odaf.export` compares actions and status of each form on 40 episodes, and refuses what differs."""
    made = guarded(reaction, kind, actor, threshold=2.0)
    made.save(tmp_path / "guard.safetensors")
    artefact = odaf.export(tmp_path / "guard.safetensors", tmp_path / "out")
    for file in ("policy.safetensors", "policy.onnx", "policy.h"):
        found = artefact.contract["checked"][file]
        assert found["checked"] and found["largest_difference"] <= 1e-5
        assert found["steps"] >= (10 if reaction == "stop" else 200)
    assert artefact.contract["guard"]["reaction"] == reaction and "4" in artefact.contract["status"]
    assert "4 is an alarm" in (tmp_path / "out" / "policy.h").read_text()
    shipped = (tmp_path / "out" / "policy_test.c").read_text().split("vectors[] = {\n")[1].split("};")[0].splitlines()
    assert len(shipped) >= 4 and any(line.startswith("    {0, ") for line in shipped)  # later steps of an episode, too
    if reaction in ("hold", "stop"):  # the others act on readings far away, where rounding decides
        assert any(re.match(r"    \{\d, [45], ", line) for line in shipped)


def test_parts_of_the_score_are_those_of_the_guarded_policy(tmp_path: Path):
    made = guarded("warn")
    form, carry = numpy_form(made, tmp_path), made.begin()
    alarms = 0
    for row in walk(40):
        before = carry.state, made.policy.begin() or carry.action
        scaled_before = np.asarray(2 * (before[1] - np.array(made.policy.action_low)), np.float32)
        scaled_before = scaled_before / (np.array(made.policy.action_high) - np.array(made.policy.action_low)) - 1.0
        action, carry = made.act(carry, row)
        scaled = (
            2 * (action - made.policy.action_low) / np.subtract(made.policy.action_high, made.policy.action_low) - 1
        )
        wanted = judged(made.score, made.policy.actor, row[None], scaled[None], (before[0], scaled_before)).parts
        found = form.step({"observation": row})
        np.testing.assert_allclose(found["guard"], np.asarray(wanted)[0], rtol=1e-3, atol=1e-4)
        np.testing.assert_allclose(found["action"], action, rtol=1e-5, atol=1e-5)
        assert form.status == (ALARM if carry.alarm[0] else FINE)
        alarms += form.status == ALARM
    assert 5 < alarms < 35


def test_a_refused_reading_deafens_no_form(tmp_path: Path):
    made = guarded("warn", threshold=1.5)
    form = numpy_form(made, tmp_path)
    folder = tmp_path / "out"
    odaf.export(made, folder, forms=["onnx", "numpy"])
    graph = OnnxPolicy(folder / "policy.onnx")
    carry = made.begin()
    rows = walk(5)
    rows[2, 1] = np.nan
    for step, row in enumerate(rows):
        _, carry = made.act(carry, row)
        _, status = graph.act(row)
        if step == 2:
            with pytest.raises(odaf_policy.Refused, match="x1 is not a finite number"):
                form.act(row)
            assert (form.status, status) == (NOT_FINITE, NOT_FINITE) and carry.alarm[0]
            continue
        form.act(row)
        assert form.status == status == (ALARM if carry.alarm[0] else FINE)
        assert np.isfinite(carry.score[0])
    far = rows[0] + 1e4
    assert form.act(far) is not None and form.status == ALARM and graph.act(far)[1] == ALARM


def test_a_stop_lasts_until_a_new_episode(tmp_path: Path):
    form = numpy_form(guarded("stop", threshold=3.0), tmp_path)
    assert form.act(USUAL) is not None and form.status == FINE
    assert form.act(USUAL + 1e4) is None and form.status == STOPPED
    assert form.act(USUAL) is None and form.status == STOPPED
    form.begin()
    assert form.act(USUAL) is not None
    with pytest.raises(odaf_policy.Refused):
        form.act(USUAL * np.nan)  # an alarm, too
    assert form.act(USUAL) is None and form.status == STOPPED


def test_what_is_held_is_what_was_played(tmp_path: Path):
    form = numpy_form(guarded("hold", threshold=3.0), tmp_path)
    form.act(USUAL)
    form.acted([-1.0, 42.0])
    np.testing.assert_array_equal(form.act(USUAL + 1e4), np.array([-1.0, 42.0], np.float32))


def test_a_guard_of_unknown_dynamics_or_with_limits_is_refused(tmp_path: Path):
    made = guarded("warn")

    class Strange(DeterministicDynamics):
        pass

    strange = Strange(**vars(made.score.outcome))
    odd = dataclasses.replace(made, score=dataclasses.replace(made.score, outcome=strange))
    with pytest.raises(ConfigError, match="Strange: no description of how it predicts"):
        guarded_program(odd)
    with pytest.raises(ConfigError, match="not offered together with a guard"):
        odaf.export(made, tmp_path / "out", max_change={"valve": 1.0})


def test_the_guarded_form_needs_numpy_alone(tmp_path: Path):
    odaf.export(guarded("warn"), tmp_path / "out", forms=["numpy"])
    text = (
        "import sys; sys.path.insert(0, 'out'); from odaf_policy import Policy; p = Policy('out/policy.safetensors')\n"
        "p.act([1e5, 0, 0, 0]); print(p.status, 'jax' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-I", "-c", text], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout.split() == ["4", "False"], done.stderr
