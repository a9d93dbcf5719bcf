"""Bytes of a saved policy, and microseconds an action for one observation, against the actor alone.

The policy is that of `odaf` on Hopper's shapes: 11 numbers in, 3 out, two hidden layers of 256. Timed is `policy(row)`
on a NumPy row in the user's units: it checks shape and values, normalises, acts, maps to the user's bounds, clips, and
checks that the action is finite. Beside it stands the least that could act: the actor's network alone, compiled, called
with its parameters on the device and a NumPy row that is normalised already, its answer turned into a NumPy array and
not looked at. Both are called in turn, a few calls each, for many rounds, so that a busy machine is busy for both.
Figures are medians over the rounds, of the ratio too; "undisturbed" is what the quickest tenth of the rounds took.

Beside them stand steps of policies that compute their observations: of the 11 numbers one or four are formulas, or
seven are those of the row before and what was done there (`policy.act(carry, readings)`).
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.learners import SPEC
from benchmarks.machine import machine, write_figures
from odaf.data.derived import Derivation
from odaf.data.normalisation import Normaliser
from odaf.runs import presets
from odaf.training.policy import Policy
from odaf.training.run_directory import blank_state


def policy_of(learner: str) -> Policy:
    """The policy of a preset with random parameters, on Hopper's shapes."""
    rng = np.random.default_rng(0)
    algorithm = presets.load(learner, {"hidden_sizes": (256, 256)})

    def random(leaf: jax.ShapeDtypeStruct) -> jax.Array:
        return jnp.asarray(0.05 * rng.standard_normal(leaf.shape), leaf.dtype)

    actor = jax.tree.map(random, algorithm.actor(blank_state(algorithm, SPEC)))
    names = tuple(f"observation_{index}" for index in range(SPEC.obs_dim))
    normaliser = Normaliser(rng.normal(size=SPEC.obs_dim), rng.uniform(0.5, 2.0, SPEC.obs_dim))
    return Policy(actor, normaliser, SPEC.action_low, SPEC.action_high, names)


def bare(policy: Policy, row: np.ndarray) -> Callable[[], np.ndarray]:
    """The compiled actor alone on one normalised row."""
    structure = jax.tree.structure(policy.actor)
    arrays = tuple(jax.tree.leaves(policy.actor))
    compiled = jax.jit(lambda arrays, rows: jax.tree.unflatten(structure, arrays).mode(rows))
    rows = np.asarray(policy.normaliser.normalise(row), np.float32)[None]
    return lambda: np.asarray(compiled(arrays, rows))


def on_readings(policy: Policy, parts: int, formulas: int, lags: int) -> Callable[[], object]:
    """A step of the policy whose observations are so many parts, some of them formulas, and earlier rows of these."""
    actions = tuple(f"a{index}" for index in range(policy.act_dim))
    readings = [{"recipe": "readings", "columns": [f"x{index}" for index in range(parts - formulas)]}]
    texts = [f"greatest(x{index}, 0) - abs(x{index + 1})" for index in range(formulas)]
    computed = [{"recipe": "expression", "name": f"y{index}", "expression": text} for index, text in enumerate(texts)]
    earlier = [{"recipe": "lags", "rows": lags, "actions": list(actions)}] if lags else []
    derivation = Derivation.from_recipes([*readings, *computed, *earlier])
    assert len(derivation.names) == policy.obs_dim
    deriving = replace(policy, observation_names=derivation.names, action_names=actions, derivation=derivation)
    row = np.random.default_rng(2).normal(size=len(derivation.readings))
    carry = deriving.begin()
    for _ in range(lags):
        carry = deriving.acted(deriving.act(carry, row)[1], np.zeros(policy.act_dim))
    return lambda: deriving.act(carry, row)


def seconds_a_call(call: Callable[[], object], calls: int) -> float:
    """Wall-clock seconds of one of so many calls."""
    began = time.perf_counter()
    for _ in range(calls):
        call()
    return (time.perf_counter() - began) / calls


def main(arguments: list[str] | None = None) -> None:
    """Measure, print a line each, and write the figures if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--learner", default="odaf", help="preset whose policy acts")
    parser.add_argument("--rounds", type=int, default=1500, help="turns of each")
    parser.add_argument(
        "--calls", type=int, default=10, help="calls a turn; few, so that both calls of a pair find the machine alike"
    )
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args(arguments)

    about, policy = machine(), policy_of(options.learner)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "policy.safetensors"
        policy.save(file)
        size = file.stat().st_size
    row = np.random.default_rng(1).normal(size=SPEC.obs_dim).astype(np.float32)
    calls = {"policy": lambda: policy(row), "bare": bare(policy, row)}
    assert np.abs(calls["policy"]() - calls["bare"]()[0]).max() < 1e-5
    calls |= {
        "one formula": on_readings(policy, 11, 1, 0),
        "four formulas": on_readings(policy, 11, 4, 0),
        "the row before": on_readings(policy, 4, 0, 1),
    }
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for turn in range(options.rounds):
        for name in list(calls)[:: 1 if turn % 2 else -1]:
            seconds[name].append(seconds_a_call(calls[name], options.calls))
    ratios = np.array(seconds["policy"]) / np.array(seconds["bare"])
    low, middle, high = np.quantile(ratios, [0.1, 0.5, 0.9]).tolist()
    micro = {name: float(np.median(values)) * 1e6 for name, values in seconds.items()}
    quick = {name: float(np.quantile(values, 0.1)) * 1e6 for name, values in seconds.items()}
    figures = {
        "learner": options.learner,
        "bytes": size,
        "microseconds": micro,
        "ratio": middle,
        "ratio_in_eight_rounds_of_ten": [low, high],
        "undisturbed": {"microseconds": quick, "ratio": quick["policy"] / quick["bare"]},
        "rounds": options.rounds,
        "calls": options.calls,
    }
    print(f"{options.learner}: a saved policy has {size / 1e6:.2f} MB")
    for what, each, ratio in (("median", micro, middle), ("undisturbed", quick, quick["policy"] / quick["bare"])):
        print(f"{what}: {each['policy']:.0f} us by the policy, {each['bare']:.0f} us bare, {ratio:.2f} times")
    for name in list(calls)[2:]:
        print(f"observations computed, {name}: {micro[name]:.0f} us, undisturbed {quick[name]:.0f} us")
    write_figures(options.json, about, figures)


if __name__ == "__main__":
    main()
