"""SAC-N of a checkout of CORL on the same problem, to be run by an interpreter that has PyTorch and tqdm: prints JSON.

    python benchmarks/peer_corl.py CHECKOUT

Its trackers, settings and simulators are not needed for an update, and are stood in for.
"""

import importlib.util
import json
import statistics
import sys
import time
from pathlib import Path
from unittest.mock import MagicMock

import torch  # pyright: ignore[reportMissingImports]

OBS_DIM, ACT_DIM, BATCH, CRITICS, HIDDEN = 11, 3, 256, 10, 256
ROWS, WARM, UPDATES, ROUNDS = 200_000, 20, 200, 3
FILE = Path("algorithms", "offline", "sac_n.py")


def main(checkout: Path) -> None:
    """Time updates of SAC-N with ten critics on random data that lie on the device."""
    for name in ("d4rl", "gym", "pyrallis", "wandb"):
        sys.modules.setdefault(name, MagicMock())
    spec = importlib.util.spec_from_file_location("sac_n", checkout / FILE)
    assert spec is not None and spec.loader is not None
    corl = importlib.util.module_from_spec(spec)
    sys.modules["sac_n"] = corl
    spec.loader.exec_module(corl)

    device = "cuda" if torch.cuda.is_available() else "cpu"
    torch.manual_seed(0)
    actor = corl.Actor(OBS_DIM, ACT_DIM, HIDDEN).to(device)
    critics = corl.VectorizedCritic(OBS_DIM, ACT_DIM, HIDDEN, CRITICS).to(device)
    optimisers = [torch.optim.Adam(network.parameters(), lr=3e-4) for network in (actor, critics)]
    learner = corl.SACN(actor, optimisers[0], critics, optimisers[1], device=device)
    widths = (OBS_DIM, ACT_DIM, 1, OBS_DIM, 1)
    columns = [torch.rand(ROWS, width, device=device) for width in widths]
    columns[-1] = torch.zeros_like(columns[-1])

    def updates(count: int) -> float:
        before = time.perf_counter()
        for _ in range(count):
            rows = torch.randint(0, ROWS, (BATCH,), device=device)
            learner.update([column[rows] for column in columns])  # its metrics wait for the device
        return count / (time.perf_counter() - before)

    updates(WARM)
    speed = statistics.median(updates(UPDATES) for _ in range(ROUNDS))
    products = "tensorfloat32" if torch.backends.cuda.matmul.allow_tf32 and device == "cuda" else "float32"
    what = f"CORL's SAC-N on PyTorch {torch.__version__}, {device}"
    print(json.dumps({"corl-sac-n": {"updates_per_second": speed, "products": products, "what": what}}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
