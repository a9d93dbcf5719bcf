"""d3rlpy on the same problem, to be run by an interpreter that has d3rlpy 2 and PyTorch: prints JSON.

Make such an interpreter with

    python3 -m venv .venv-peer && .venv-peer/bin/python -m pip install -r benchmarks/peer-requirements.txt

and give it to `updates_per_second.py --peer-python .venv-peer/bin/python`.
"""

import json
import statistics
import time

import d3rlpy  # pyright: ignore[reportMissingImports]
import numpy as np

OBS_DIM, ACT_DIM, BATCH, CRITICS, HIDDEN = 11, 3, 256, 10, [256, 256, 256]
ROWS, WARM, UPDATES, ROUNDS = 20_000, 20, 60, 3


def main() -> None:
    """Time SAC with ten critics, which is SAC-N, on random data."""
    d3rlpy.seed(0)
    random = np.random.default_rng(0)
    ends = np.zeros(ROWS)
    ends[999::1000] = 1.0
    data = d3rlpy.dataset.MDPDataset(
        random.normal(size=(ROWS, OBS_DIM)).astype(np.float32),
        random.uniform(-1.0, 1.0, size=(ROWS, ACT_DIM)).astype(np.float32),
        random.uniform(size=(ROWS, 1)).astype(np.float32),
        np.zeros(ROWS),
        ends,
    )
    encoder = d3rlpy.models.VectorEncoderFactory(HIDDEN)
    config = d3rlpy.algos.SACConfig(
        batch_size=BATCH, n_critics=CRITICS, actor_encoder_factory=encoder, critic_encoder_factory=encoder
    )
    learner = config.create(device="cpu")
    learner.build_with_dataset(data)

    def update(count: int) -> float:
        start = time.perf_counter()
        for _ in range(count):
            learner.update(data.sample_transition_batch(BATCH))
        return count / (time.perf_counter() - start)

    update(WARM)
    speed = statistics.median(update(UPDATES) for _ in range(ROUNDS))
    name = f"d3rlpy {d3rlpy.__version__}"
    print(json.dumps({"d3rlpy-sac-n": {"updates_per_second": speed, "what": f"{name}: SAC with ten critics"}}))


if __name__ == "__main__":
    main()
