#!/bin/bash
# d3rlpy's BEAR: after its warm-up the actor does not feel the discrepancy that it is to be held by.
#
# Expected: the actor's loss is minus the value plus alpha (discrepancy - threshold), so a larger alpha gives its step another gradient;
# with alpha at 1,000 the discrepancy should decide it.
# Seen: the gradient that Adam gets is the same to rounding for alpha 1 and for alpha 1,000. The multiplier takes its own step first, by
# a backward pass through minus the discrepancy, which runs through the actor's weights too and leaves its slope there; the actor's
# pass then adds the same slope with the other sign. With that step left
# out (no settings do so; the script takes the optimiser away) alpha decides, as it should. In the warm-up gradients are cleared in between, so there it is as written.
#
# Why it matters: this is the BEAR that many tables of the last years compare with. After 40,000 updates it is soft actor-critic
# with another target, and its scores say nothing of support constraints. The loss that is logged holds the discrepancy, so no curve shows it.
#
# odaf's own BEAR steps actor and multiplier from gradients of their own; `benchmarks/parity` mends the peer before it compares.
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
import torch
from d3rlpy.dataset import TransitionMiniBatch

print(", ".join(f"{name} {version(name)}" for name in ("d3rlpy", "torch")))
random = np.random.default_rng(0)
columns = {
    "observations": random.normal(size=(64, 5)),
    "actions": random.uniform(-0.9, 0.9, size=(64, 2)),
    "rewards": random.normal(size=(64, 1)),
    "next_observations": random.normal(size=(64, 5)),
    "next_actions": random.uniform(-0.9, 0.9, size=(64, 2)),
    "terminals": np.zeros((64, 1)),
    "intervals": np.ones((64, 1)),
}


def actor_gradient(alpha, learns):
    """What the actor's optimiser gets in the first update after the warm-up."""
    d3rlpy.seed(0)
    learner = d3rlpy.algos.BEARConfig(initial_alpha=alpha, warmup_steps=0).create()
    learner.create_impl((5,), 2)
    if not learns:
        object.__setattr__(learner.impl.modules, "alpha_optim", None)
    optimiser, seen = learner.impl.modules.actor_optim, []
    step = optimiser.step

    def recorded():
        parameters = optimiser.optim.param_groups[0]["params"]
        seen.append(torch.cat([p.grad.flatten() for p in parameters if p.grad is not None]).clone())
        step()

    optimiser.step = recorded
    rows = TransitionMiniBatch(**{k: v.astype(np.float32) for k, v in columns.items()}, transitions=[])
    torch.manual_seed(1)
    learner.update(rows)
    return seen[-1]


def changed(learns):
    """How much alpha 1,000 changes the gradient that alpha 1 gives, in units of its length."""
    small, large = actor_gradient(1.0, learns), actor_gradient(1000.0, learns)
    return float((large - small).norm() / small.norm())


learning, fixed = changed(True), changed(False)
print(f"alpha 1,000 in place of 1 changes the actor's gradient by {fixed:.1f} of its length where alpha does")
print(f"not learn; expected the like where it learns, as it does in every setting; seen {learning:.1e}")
sys.exit(not (fixed > 1.0 and learning < 1e-2))
PYTHON
