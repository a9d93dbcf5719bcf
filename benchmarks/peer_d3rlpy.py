"""d3rlpy on the same problem, to be run by an interpreter that has d3rlpy 2 and PyTorch.

Make such an interpreter with

    python3 -m venv .venv-peer && .venv-peer/bin/python -m pip install -r benchmarks/peer-requirements.txt

and give it to `updates_per_second.py --peer-python .venv-peer/bin/python`, which runs this file as a module. Each line
of its input names a learner and how long to time it, in seconds; the answer is a line of JSON.
"""

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import d3rlpy  # pyright: ignore[reportMissingImports]
import numpy as np

from benchmarks.parity import peer
from benchmarks.parity.settings import LEARNERS

OBS_DIM, ACT_DIM, BATCH, CRITICS, HIDDEN = 11, 3, 256, 10, [256, 256, 256]
ROWS, WARM, PIECE = 20_000, 10, 5


def random_rows() -> Any:
    """Random rows in episodes of a thousand."""
    random = np.random.default_rng(0)
    ends = np.zeros(ROWS)
    ends[999::1000] = 1.0
    return d3rlpy.dataset.MDPDataset(
        random.normal(size=(ROWS, OBS_DIM)).astype(np.float32),
        random.uniform(-1.0, 1.0, size=(ROWS, ACT_DIM)).astype(np.float32),
        random.uniform(size=(ROWS, 1)).astype(np.float32),
        np.zeros(ROWS),
        ends,
    )


def learner_of(name: str) -> tuple[Any, str]:
    """A learner of this name at the sizes that ours is timed with, and what it is in words."""
    if name == "sac-n":
        encoder = d3rlpy.models.VectorEncoderFactory(HIDDEN)
        config = d3rlpy.algos.SACConfig(
            batch_size=BATCH, n_critics=CRITICS, actor_encoder_factory=encoder, critic_encoder_factory=encoder
        )
        return config.create(device="cpu"), "SAC with ten critics"
    if name.startswith("fqe:"):  # of a policy as deployed; critics, width and batch are in the name
        critics, width, batch = map(int, name.split(":")[1:])
        encoder = d3rlpy.models.VectorEncoderFactory([width, width])
        policy = d3rlpy.algos.TD3Config(actor_encoder_factory=encoder).create(device="cpu")
        policy.build_with_dataset(random_rows())
        config = d3rlpy.ope.FQEConfig(batch_size=batch, n_critics=critics, encoder_factory=encoder)
        return d3rlpy.ope.FQE(algo=policy, config=config, device="cpu"), f"FQE with {critics} critics"
    # BEAR after its warm-up, when an update costs most.
    learner = peer.configured(name, {**LEARNERS[name], "batch_size": BATCH, "warm_up_steps": 0})
    return learner, type(learner).__name__


def timed(learner: Any, rows: Any) -> Callable[[float], float]:
    """A function of seconds: updates a second over about so long, batches drawn as d3rlpy's users draw them."""
    learner.build_with_dataset(rows)

    def update(count: int) -> float:
        start = time.perf_counter()
        for _ in range(count):
            learner.update(rows.sample_transition_batch(learner.batch_size))
        return time.perf_counter() - start

    update(WARM)

    def speed(seconds: float) -> float:
        taken, done = update(PIECE), PIECE
        while taken < seconds:
            taken, done = taken + update(PIECE), done + PIECE
        return done / taken

    return speed


def main() -> None:
    """Answers one line after another."""
    d3rlpy.seed(0)
    rows, known = random_rows(), {}
    for line in sys.stdin:
        name, seconds = line.split()
        if name not in known:
            learner, what = learner_of(name)
            known[name] = timed(learner, rows), f"d3rlpy {d3rlpy.__version__}: {what}"
        speed, what = known[name]
        print(json.dumps({"updates_per_second": speed(float(seconds)), "what": what}), flush=True)


if __name__ == "__main__":
    main()
