"""How many updates a second each learner makes, beside what the machine's matrix products allow.

The ceiling is the batched product (10, 256, 256) x (10, 256, 256) of the compiler that trains, measured in the same
rounds as the learners, so that a slow or busy machine slows both. Floating-point operations are counted by hand:

    one unit u   = a forward pass of the batch through all K critics = 2 * batch * K * (products of layer widths)
    critic step  = 1 u for the target, 3 u for loss and gradient
    actor step   = 1 u forward, 1 u back to the actions
    outcome term = gradient solver: (2 u to find the corner, 2 u at the corner) * states / batch
                   sample solver: (1 u a draw, 2 u at the chosen draw) * states / batch
    OOD term     = 3 u an action

Actor, dynamics model and optimiser are not counted: the share is a lower bound of how busy the products are.
"""

import argparse
import functools
import itertools
import json
import platform
import statistics
import time
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr

from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.data.sampling import sample
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.experiments import presets

PRESETS = ("behaviour-cloning", "sac-n", "odaf-without-outcome", "odaf", "odaf-pessimistic", "odaf-paper")
SPEC = Spec(4, 2, (-1.0, -1.0), (1.0, 1.0), 0.0, 1.0, False, 200)
ROWS = 200_000
CEILING_REPEATS = 50


def gflop_per_update(algorithm: Any) -> float:
    """Counted operations of one update in units of 1e9; 0 for learners that are not counted."""
    if not isinstance(algorithm, EnsembleSAC):
        return 0.0
    sizes = (SPEC.obs_dim + SPEC.act_dim, *algorithm.hidden_sizes, 1)
    products = sum(a * b for a, b in itertools.pairwise(sizes))
    unit = 2.0 * algorithm.batch_size * algorithm.num_critics * products
    units = 6.0
    for term in algorithm.active_terms:
        settings: Any = term
        if term.name == "outcome":
            share = (settings.num_states or algorithm.batch_size) / algorithm.batch_size
            units += share * (
                2.0 * settings.ascent_steps + 2.0 if settings.solver == "gradient" else (settings.num_draws + 2.0)
            )
        elif term.name == "ood":
            units += 3.0 * settings.num_actions * (1 if settings.next_deviations is None else 2)
    return units * unit / 1e9


def trainer(algorithm: Any, updates: int) -> Any:
    """A call that makes `updates` updates on random data and waits for them."""
    keys = jr.split(jr.key(0), 5)
    columns = Transitions(
        jr.normal(keys[0], (ROWS, SPEC.obs_dim)),
        jr.uniform(keys[1], (ROWS, SPEC.act_dim), minval=-1.0, maxval=1.0),
        jr.uniform(keys[2], (ROWS,)),
        jr.normal(keys[3], (ROWS, SPEC.obs_dim)),
        jnp.zeros(ROWS),
    )
    state = algorithm.init(keys[4], SPEC, algorithm.untrained_side(keys[4], SPEC))
    arrays, static = eqx.partition(state, eqx.is_array)

    @functools.partial(jax.jit, donate_argnums=1)
    def stretch(columns, arrays):
        def step(arrays, index):
            key_batch, key_update = jr.split(jr.fold_in(keys[0], index))
            batch = sample(columns, key_batch, algorithm.batch_size)
            state, _ = algorithm.update(eqx.combine(arrays, static), batch, key_update)
            return eqx.partition(state, eqx.is_array)[0], None

        return jax.lax.scan(step, arrays, jnp.arange(updates))[0]

    carried = [arrays]

    def call() -> None:
        carried[0] = jax.block_until_ready(stretch(columns, carried[0]))

    return call


def ceiling() -> Any:
    """A call that makes `CEILING_REPEATS` batched products and waits for them."""
    weights = jr.normal(jr.key(0), (10, 256, 256)) / 16.0

    @jax.jit
    def products(x):
        return jax.lax.fori_loop(0, CEILING_REPEATS, lambda _, x: jnp.einsum("kbi,kio->kbo", x, weights), x)

    return lambda: jax.block_until_ready(products(weights))


def seconds_of(call: Any) -> float:
    """Wall seconds of one call."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def main(arguments: list[str] | None = None) -> None:
    """Measure in interleaved rounds, print the medians, and write them if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--presets", nargs="+", default=PRESETS, help="which presets to time")
    parser.add_argument("--updates", type=int, default=50, help="updates in one round")
    parser.add_argument("--rounds", type=int, default=5, help="rounds; the median is reported")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args(arguments)

    algorithms = {name: presets.load(name) for name in options.presets}
    calls = {name: trainer(algorithm, options.updates) for name, algorithm in algorithms.items()}
    product = ceiling()
    for call in (product, *calls.values(), *calls.values()):  # compile, then touch every buffer once more
        call()
    times: dict[str, list[float]] = {name: [] for name in ("ceiling", *calls)}
    for _ in range(options.rounds):
        times["ceiling"].append(seconds_of(product))
        for name, call in calls.items():
            times[name].append(seconds_of(call))

    flop = 2.0 * CEILING_REPEATS * 10 * 256**3
    peak = flop / statistics.median(times.pop("ceiling")) / 1e9
    print(f"batched products: {peak:.0f} GFLOP/s")
    learners = {}
    for name, rounds in times.items():
        speed = options.updates / statistics.median(rounds)
        work = gflop_per_update(algorithms[name])
        learners[name] = {
            "updates_per_second": speed,
            "gflop_per_update": work,
            "ceiling_share": speed * work / peak,
        }
        print(f"{name:28} {speed:8.1f} updates/s  {work:6.2f} GFLOP  {speed * work / peak:5.0%} of the ceiling")
    if options.json:
        machine = {"platform": platform.platform(), "device": str(jax.devices()[0]), "jax": jax.__version__}
        options.json.parent.mkdir(parents=True, exist_ok=True)
        content = {"machine": machine, "ceiling_gflops": peak, "learners": learners}
        options.json.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
