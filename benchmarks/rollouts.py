"""Model steps a second of rollouts at Hopper's sizes: members of 4x200, one elite a row, and all seven.

A step is an action of a policy of two layers of 256, a draw of the model and what is kept of it in the ring, as a
refresh of MOPO or COMBO does it; no rollout ends early. With one elite a row no other member is evaluated (COMBO); with
all seven the largest deviation is measured too (MOPO). Both are timed in turns, so that a busy machine is busy for
both; figures are medians. Beside the seconds of the clock stand those that the process had of all cores together, which
tell more where others work on the same machine.
"""

import argparse
import statistics
import sys
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.learners import SPEC
from benchmarks.machine import machine, write_figures
from odaf.algorithms.combo import COMBO
from odaf.algorithms.model_based import ModelBased, ModelBasedState
from odaf.algorithms.mopo import MOPO
from odaf.data.transitions import Transitions

BARS = {"one elite a row": 200_000, "all seven members": 60_000}  # model steps a second on two cores


class Refreshes:
    """Refreshes of a learner, compiled."""

    def __init__(self, learner: ModelBased):
        self.learner = learner
        key = jr.key(0)
        state = learner.init(key, SPEC, learner.untrained(jr.key(1), SPEC))
        rows = jnp.zeros(10_000)
        states = jr.normal(jr.key(2), (10_000, SPEC.obs_dim))
        self.columns = Transitions(states, jnp.zeros((10_000, SPEC.act_dim)), rows, states, rows)
        self.refresh = jax.jit(learner.refresh, donate_argnums=0)
        self.state: ModelBasedState = jax.block_until_ready(self.refresh(state, self.columns, key))

    def seconds(self, number: int) -> tuple[float, float]:
        """Of one refresh, on the clock and of the processor."""
        began, had = time.perf_counter(), time.process_time()
        self.state = jax.block_until_ready(self.refresh(self.state, self.columns, jr.key(number)))
        return time.perf_counter() - began, time.process_time() - had


def main(arguments: list[str] | None = None) -> None:
    """Measure, print a line each, and write the figures if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=10_000, help="rollouts at a time")
    parser.add_argument("--horizon", type=int, default=5, help="steps of each")
    parser.add_argument("--rounds", type=int, default=5, help="turns of each")
    parser.add_argument("--json", type=Path, help="file that the figures are written to")
    options = parser.parse_args(arguments)
    about = machine()
    given: dict[str, Any] = {
        "rollout_rows": options.rows, "horizon": options.horizon, "hidden_sizes": (256, 256), "retained": 1,
    }  # fmt: skip
    runs = {"one elite a row": Refreshes(COMBO(**given)), "all seven members": Refreshes(MOPO(**given))}
    taken: dict[str, list[tuple[float, float]]] = {name: [] for name in runs}
    for number in range(options.rounds):
        for name, run in runs.items():
            taken[name].append(run.seconds(number))
    steps = options.rows * options.horizon
    figures: dict[str, Any] = {"rows": options.rows, "horizon": options.horizon}
    for name, seconds in taken.items():
        clock, processor = (steps / statistics.median(part) for part in zip(*seconds, strict=True))
        figures[name] = {"per_second": clock, "per_processor_second": processor, "asked_for_on_two_cores": BARS[name]}
        print(
            f"{name}: {clock:,.0f} model steps a second, {processor:,.0f} a second of one core; "
            f"asked for on two cores {BARS[name]:,}"
        )
    print(f"{about['cores']} cores, load before {about['load_before']}")
    write_figures(options.json, about, figures)


if __name__ == "__main__":
    main()
