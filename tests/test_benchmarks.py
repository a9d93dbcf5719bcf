"""The timed scripts still run: tiny sizes, figures not looked at."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import jax
import jax.random as jr
import pytest

from odaf.data.sampling import sample

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks import lanes_trace, learners, operations, parts, updates_per_second  # noqa: E402

SCRIPTS = {
    "acting": ["--rounds", "2", "--calls", "2"],
    "deployed": ["--rounds", "2", "--calls", "2"],
    "fitted_q": ["--rows", "3000", "--steps", "2", "--sizes", "2:8:8", "--rounds", "1"],
    "load_dataset": ["--rows", "3000"],
    "import_table": ["--rows", "3000"],
    "first_update": ["--rows", "3000", "--learners", "sac-n", "--updates", "2"],
    "many_seeds": ["--learners", "sac-n", "--seeds", "1", "--updates", "2", "--rounds", "1", "--wait", "0"],
    "lanes": [
        *("--learners", "rebrac", "--sizes", "8", "--batch", "8", "--sets", "3", "--rows", "50", "--lanes", "4"),
        *("--updates", "2", "--rounds", "1", "--wait", "0", "--trace"),  # and a folder
    ],
    "updates_per_second": ["--learners", "sac-n", "--rounds", "1", "--seconds", "0.01"],
}


SLOW = ("first_update", "fitted_q", "lanes", "many_seeds", "updates_per_second")


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in SCRIPTS])
def test_a_script_runs_and_writes_its_figures(name, tmp_path):
    out = tmp_path / "figures.json"
    words = [*SCRIPTS[name], *[str(tmp_path)] * (name == "lanes")]
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / f"{name}.py"), *words, "--json", str(out)],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    figures = json.loads(out.read_text())
    assert "machine" in figures
    if name == "lanes":
        (found,) = figures["figures"]
        assert set(found["updates_per_second"]) == {"lanes", "processes"}
        assert found["trace"]["milliseconds"]["products"] > 0.0


def test_a_trace_is_summed_by_kinds_of_operations():
    events = [("dot.7", 3e6), ("add_reduce_fusion", 1e6), ("dot.7", 1e6), ("gemm_fusion_dot.2", 2e6), ("tanh.1", 5e5)]
    found = lanes_trace.summed(events)
    assert found["milliseconds"] == {"products": 6.0, "sums": 1.0, lanes_trace.OTHER: 0.5}
    assert found["largest"][0] == {"operation": "dot.7", "milliseconds": 4.0, "calls": 2}


STUB = """#!/bin/sh
echo "$XLA_FLAGS | $*" >> "$CALLS"
case "$*" in *default_backend*) echo gpu ;; *lanes.py*--sets*) exit 1 ;; esac
"""


@pytest.mark.parametrize("minutes", ["9", "0.0001"])
def test_a_machine_with_an_accelerator_is_measured_with_and_without_an_order_of_sums(tmp_path, minutes):
    """With a stand-in for Python that notes how it is called, and fails where lanes have several data sets."""
    stub, calls = tmp_path / "python", tmp_path / "calls"
    stub.write_text(STUB)
    stub.chmod(0o755)
    done = subprocess.run(
        [str(ROOT / "benchmarks" / "device.sh"), minutes, str(tmp_path / "out")],
        env={**os.environ, "PYTHON": str(stub), "CALLS": str(calls), "LANES_OPTIONS": "--rows 9", "XLA_FLAGS": "--own"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    parts = [line for line in calls.read_text().splitlines() if "lanes.py" in line]
    if minutes != "9":
        assert not parts and "sac-n: no time is left" in done.stdout
        return
    assert len(parts) == 7 and all(line.endswith("--rows 9") for line in parts)
    ordered = [line for line in parts if line.startswith("--own --xla_gpu_deterministic_ops=true | ")]
    assert len(ordered) == 2 and all("--precision tensorfloat32 --json" in line for line in ordered)
    assert "--precision tensorfloat32 float32" in parts[0] and "--lanes 1 64 400" in " ".join(parts)
    assert "robots: not finished" in done.stdout


def _counted_by_the_compiler(algorithm) -> float:
    """Operations of one compiled update. Loops would be counted as one pass, so members are written out."""
    state, batch = learners.state_of(algorithm), sample(learners.columns(), jr.key(0), algorithm.batch_size)
    lowered = jax.jit(lambda key: algorithm.update(state, batch, key)[0]).lower(jr.key(1))
    return (lowered.cost_analysis() or {})["flops"]


def test_unit_of_the_count_is_the_one_that_papers_use():
    forward, _ = operations.passes((14, 256, 256, 256, 1))
    assert forward == 2 * 134_912
    sac = operations.flop_per_update(learners.load("sac-n"), learners.SPEC)
    assert sac is not None and 6 * 256 * 10 * forward < sac < 1.08 * 6 * 256 * 10 * forward


# The compiler also counts what is no product, and what our code does beyond what is needed: EDAC's critics go forward
# once for the loss, once for the slopes and once along them.
@pytest.mark.parametrize(("name", "most"), [("sac-n", 1.1), ("pbrl", 1.1), ("edac", 1.3)])
def test_operations_counted_by_hand_are_those_that_the_compiler_counts(name, most, monkeypatch):
    monkeypatch.setattr("odaf.components.critics.usable_cores", lambda: 2)
    monkeypatch.setattr("odaf.components.chunks.ROWS_AT_ONCE", 10**9)  # nor in parts
    monkeypatch.setitem(learners.PROBLEM, "num_critics", 2)
    algorithm = learners.load(name)
    by_hand = operations.flop_per_update(algorithm, learners.SPEC)
    assert by_hand is not None
    assert by_hand < _counted_by_the_compiler(algorithm) < most * by_hand


def test_draws_and_states_of_the_outcome_term_are_counted(monkeypatch):
    def named(name: str) -> float:
        return operations.flop_per_update(learners.load(name), learners.SPEC) or 0.0

    def count(**changes: Any) -> float:
        term = {f"outcome.{field}": value for field, value in changes.items()}
        monkeypatch.setitem(learners.NAMES, "probe", ("odaf", term))
        return named("probe")

    base = named("odaf-base")
    assert count(num_states=64) - base == pytest.approx((count(num_states=None) - base) / 4)
    five, six = (count(num_states=None, solver="sample", num_draws=draws) for draws in (5, 6))
    forward = operations.passes((14, 256, 256, 256, 1))[0] * 10
    assert forward * 256 < six - five < 1.5 * forward * 256
    assert named("odaf-sampled-naive") == named("odaf-sampled")


def test_an_update_is_shown_by_its_parts():
    found = parts.parts_of(learners.load("odaf"))
    assert {"whole update", "targets", "critics' gradient", "actor's gradient with terms"} <= found.keys()


def test_what_is_asked_of_a_learner_grows_with_the_machine(capsys):
    peers = {"iql": {"updates_per_second": 100.0}, "bear": {"updates_per_second": 10.0}}
    speeds = {"iql": 450.0, "bear": 19.0, "td3-bc": 500.0, "rebrac": 1.0}
    asked = updates_per_second.laid_beside(speeds, peers, peak=165.0)
    assert asked["iql"]["floor"] == pytest.approx(256.5) and asked["iql"]["times_d3rlpy"] == pytest.approx(4.5)
    assert {name: row["holds"] for name, row in asked.items()} == {"iql": True, "bear": False, "td3-bc": True}
    assert "too slow" in capsys.readouterr().out
    assert not updates_per_second.laid_beside({"iql": 390.0}, peers, peak=165.0)["iql"]["holds"]


def test_the_other_learners_have_the_sizes_of_d3rlpys():
    assert {"td3-bc", "iql", "cql"} <= set(learners.OTHERS)
    cql = learners.load("cql")
    assert (cql.critic_hidden_sizes, cql.num_actions, cql.batch_size) == ((256, 256), 10, 256)
    assert learners.columns(learners.load("rebrac").view().extras).extras["next_actions"].shape[1] == 3
