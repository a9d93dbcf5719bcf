#!/bin/bash
# d3rlpy's auto-encoder of actions squashes where it is told not to, and does not where it is told to.
#
# Expected: BCQ, BEAR, and PLAS learn the log's actions by a decoder that ends in a tanh; `with_squash=True`, the default, gives its
# output, and `with_squash=False` what stands before the tanh, on which BEAR takes its discrepancy.
# Seen: the other way round. The default leaves the tanh out, so the auto-encoder learns actions by a linear layer and draws some
# outside [-1, 1]; BEAR's `with_squash=False` compares the log's actions after a tanh with the actor's before one.
#
# Why it matters: BCQ takes the best of such draws, in the target and when it acts, after cutting them to the bounds, where many then
# lie exactly. A discrepancy between numbers of two different kinds is not zero where the actor does what the log does.
#
# odaf's auto-encoder of actions ends in the tanh and BEAR compares both before it; `benchmarks/parity` mends the peer before it
# compares.
set -euo pipefail
work=$(mktemp -d)
cd "$work"
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check d3rlpy==2.8.1 torch==2.13.0 numpy==2.4.6
"$work/venv/bin/python" -W ignore - 2> /dev/null <<'PYTHON' || { echo "stale, or it could not run"; exit 1; }
import sys
from importlib.metadata import version

import d3rlpy
import numpy as np
import structlog
import torch
from d3rlpy.models.torch.imitators import forward_vae_sample

print(", ".join(f"{name} {version(name)}" for name in ("d3rlpy", "torch")))
structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(50))  # d3rlpy tells much on the way
torch.set_num_threads(1)
d3rlpy.seed(0)
random = np.random.default_rng(0)
# A controller that sits at its bounds, as bang-bang controllers do.
observations = random.normal(size=(2000, 3)).astype(np.float32)
actions = np.sign(observations[:, :2]).astype(np.float32)
ends = np.zeros(2000, np.float32)
ends[199::200] = 1.0
space = d3rlpy.ActionSpace.CONTINUOUS
log = d3rlpy.dataset.MDPDataset(observations, actions, np.ones(2000, np.float32), ends, action_space=space)
learner = d3rlpy.algos.BCQConfig(batch_size=100).create()
adapter = d3rlpy.logging.NoopAdapterFactory()
learner.fit(log, n_steps=200, n_steps_per_epoch=200, show_progress=False, logger_adapter=adapter)
decoder = learner.impl.modules.vae_decoder
rows = torch.from_numpy(observations)
with torch.no_grad():
    sizes = {
        squash: forward_vae_sample(decoder, rows, 2 * 2, with_squash=squash).abs().max(dim=1).values
        for squash in (True, False)
    }
outside = {squash: float((size > 1.0).float().mean()) for squash, size in sizes.items()}
print("share of draws with a number outside [-1, 1] after 200 updates of BCQ on actions of -1 and 1")
print(f"  with_squash=True:  expected 0.00, seen {outside[True]:.2f} (largest {float(sizes[True].max()):.2f})")
print(f"  with_squash=False: expected most, seen {outside[False]:.2f} (largest {float(sizes[False].max()):.2f})")
sys.exit(not (outside[True] > 0.05 and outside[False] == 0.0))
PYTHON
