"""How long fitted Q evaluation of one policy takes on a log of 100,000 rows, and its updates beside d3rlpy's.

The whole estimate is timed as a user asks for it, with the control that it fits beside the policy. Then updates: ours
fits networks to one policy at each of `--sizes`, d3rlpy (`--peer-python`, see peer_d3rlpy.py) its fitted Q evaluation
with as many critics of the same widths on batches of the same size, in turns, so that a slow machine slows both.
The ceiling, batched products of 256 x 256, is measured in the same rounds; what share of it our products reach says how
much a better program could still gain.
"""

import argparse
import dataclasses
import statistics
import sys
import time
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import jax.random as jr
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.machine import machine, write_figures
from benchmarks.updates_per_second import FLOP_OF_CEILING, Peer, ceiling, seconds_of
from odaf.components.networks import init_mlp
from odaf.components.policies import DeterministicActor
from odaf.data import Dataset
from odaf.data.normalisation import Normaliser
from odaf.estimation import EstimateSettings, estimate
from odaf.estimation.fitted_q import Transitions, fit_q
from odaf.training.policy import Policy

OBS_DIM, ACT_DIM, EPISODE = 11, 3, 500  # of Hopper, whose medium episodes last about so long
MOST_SECONDS, TIMES_D3RLPY = 60.0, 5.0  # what is asked for
PEER = "fqe"


def log_of(rows: int) -> Dataset:
    """Random rows of Hopper's widths, half of whose episodes end and half of which are cut."""
    rng = np.random.default_rng(0)
    states = rng.normal(size=(rows + 1, OBS_DIM)).astype(np.float32)
    last = np.arange(rows) % EPISODE == min(EPISODE, rows // 2) - 1
    ends = last & (np.arange(rows) // EPISODE % 2 == 0)
    last[-1] = True
    return Dataset.from_arrays(
        states[:-1],
        rng.uniform(-1.0, 1.0, (rows, ACT_DIM)),
        rng.uniform(size=rows),
        states[1:],
        ends,
        last & ~ends,
        action_bounds=(-1.0, 1.0),
    )


def policy_of(dataset: Dataset) -> Policy:
    """A deterministic one of two layers of 256."""
    actor = DeterministicActor(init_mlp(jr.key(0), (OBS_DIM, 256, 256, ACT_DIM)))
    normaliser = Normaliser.fit(dataset.observations)
    return Policy(actor, normaliser, (-1.0,) * ACT_DIM, (1.0,) * ACT_DIM, dataset.observation_names)


@dataclasses.dataclass(frozen=True)
class Size:
    """Of a fit: networks, width of their two hidden layers, rows of a batch."""

    critics: int
    width: int
    batch: int

    @classmethod
    def parsed(cls, text: str) -> "Size":
        """As in 2:256:256."""
        return cls(*map(int, text.split(":")))

    @property
    def peer(self) -> str:
        """What peer_d3rlpy.py knows it by."""
        return f"{PEER}:{self.critics}:{self.width}:{self.batch}"

    def flop(self) -> float:
        """Of the products of an update: both passes forward, and back to parameters and activations."""
        first, hidden, last = (OBS_DIM + ACT_DIM + 2) * self.width, self.width**2, 2 * self.width
        return 2.0 * self.critics * self.batch * (3 * first + 4 * (hidden + last))


class Updates:
    """Steps of our fit, timed between the ends of two stretches, so that compilation is not counted."""

    def __init__(self, dataset: Dataset, policy: Policy, size: Size):
        self.settings = EstimateSettings(hidden_sizes=(size.width,) * 2, batch_size=size.batch)
        self.critics = size.critics
        normalise = policy.normaliser.normalise
        self.rows = Transitions(
            np.asarray(normalise(dataset.observations), np.float32),
            dataset.actions,
            dataset.rewards.astype(np.float64),
            dataset.terminated,
            np.asarray(normalise(dataset.next_observations), np.float32),
        )
        self.next_actions = np.asarray(policy.actor.mode(jnp.asarray(self.rows.next_observations)))[None, :, None]

    def speed(self, stretches: int) -> float:
        """Updates a second."""
        ends: list[tuple[int, float]] = []
        fit_q(
            self.rows,
            self.next_actions,
            np.tile(np.arange(len(self.rows.rewards)), self.critics),
            1_000,
            (1.0,),
            jr.key(0),
            members=self.critics,
            progress=lambda done, total: ends.append((done, time.perf_counter())),
            **{**self.settings.fitting(), "steps": 1_000 * (1 + stretches)},
        )
        (first, start), (last, end) = ends[0], ends[-1]
        return (last - first) / (end - start)


def main(arguments: list[str] | None = None) -> None:
    """Time the whole estimate once, then updates in rounds; print the figures, and write them if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=int, default=100_000)
    parser.add_argument("--steps", type=int, default=EstimateSettings().steps, help="of each fit, at most")
    parser.add_argument(
        "--sizes",
        nargs="+",
        type=Size.parsed,
        default=[Size(2, 256, 256), Size(8, 128, 128)],
        metavar="CRITICS:WIDTH:BATCH",
        help="where updates are laid beside d3rlpy's: networks, width of two hidden layers, rows an update; by default "
        "what d3rlpy's users take, and what ours do (2:256:256 8:128:128)",
    )
    parser.add_argument("--rounds", type=int, default=3, help="rounds of updates; the median is reported")
    parser.add_argument("--peer-python", type=Path, help="interpreter that has d3rlpy: time it too")
    parser.add_argument("--json", type=Path, help="file for the figures")
    options = parser.parse_args(arguments)
    about, dataset = machine(), log_of(options.rows)
    policy = policy_of(dataset)

    start, used = time.perf_counter(), time.process_time()
    found = estimate(policy, dataset, method="fqe", steps=options.steps)
    seconds, processor_seconds = time.perf_counter() - start, time.process_time() - used
    assert found["fqe"].value is not None
    asked = "" if seconds <= MOST_SECONDS else f"  too slow: at most {MOST_SECONDS:.0f} s are asked for"
    print(
        f"fitted Q evaluation of one policy, {options.rows:,} rows: {seconds:.1f} s by the clock, "
        f"{processor_seconds:.1f} s of processors{asked}",
        flush=True,
    )

    product, peer = ceiling(), Peer(options.peer_python)
    product()
    ours, ceilings = {size: Updates(dataset, policy, size) for size in options.sizes}, []
    speeds: dict[Size, list[float]] = {size: [] for size in ours}
    for size in ours if options.peer_python is not None else ():
        peer.measure(size.peer, 0.0)  # builds it
    peer.speeds.clear()
    for _ in range(options.rounds):
        ceilings += [seconds_of(product) for _ in range(3)]
        for size, updates in ours.items():
            speeds[size].append(updates.speed(1))
            if options.peer_python is not None:
                peer.measure(size.peer, 3.0)
    peer.close()
    peak = FLOP_OF_CEILING / statistics.median(ceilings)
    updates = [_figures(size, statistics.median(speeds[size]), peak, peer.speeds.get(size.peer)) for size in ours]
    figures = {
        "seconds_of_an_estimate": seconds,
        "processor_seconds_of_an_estimate": processor_seconds,
        "rows": options.rows,
        "settings": dataclasses.asdict(dataclasses.replace(EstimateSettings(), steps=options.steps)),
        "ceiling_gflops": peak / 1e9,
        "updates": updates,
    }
    write_figures(options.json, about, figures)


def _figures(size: Size, speed: float, peak: float, theirs: list[float] | None) -> dict[str, Any]:
    """Prints what an update costs at one size, and returns it."""
    figures = {
        "critics": size.critics,
        "width": size.width,
        "batch": size.batch,
        "updates_per_second": speed,
        "ceiling_share": speed * size.flop() / peak,
    }
    print(
        f"{size.critics} critics, {size.width} wide, {size.batch} rows: {speed:.0f} updates a second, products at "
        f"{figures['ceiling_share']:.0%} of the ceiling of {peak / 1e9:.0f} GFLOP/s"
    )
    if theirs:
        figures |= {"d3rlpy_updates_per_second": statistics.median(theirs)}
        figures |= {"times_d3rlpy": speed / figures["d3rlpy_updates_per_second"]}
        print(
            f"    d3rlpy: {figures['d3rlpy_updates_per_second']:.0f} a second; {figures['times_d3rlpy']:.1f} times as "
            f"fast, asked {TIMES_D3RLPY:g} times"
        )
    return figures


if __name__ == "__main__":
    main()
