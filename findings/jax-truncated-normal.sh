#!/bin/bash
# jax.random.truncated_normal gives the wrong end of the interval where its mean lies six spreads outside.
#
# Expected: a normal of mean 1.6 and spread 0.1, cut to actions in [-1, 1], gives numbers just below 1 (mean 0.984, as SciPy says).
# Seen: -1, every time, with every key. Draws go through erf, which is 1 in float32 from 5.4 spreads on; there both ends of the interval
# look the same, and the draw is clipped to the farther one. At five spreads outside there are ten different numbers, of which one
# in fifteen is -1. No NaN, no warning. The density of the same distribution, jax.scipy.stats.truncnorm, is right.
# Its maintainers have known of extreme bounds since 2022 (issue 10951).
#
# Why it matters: planners by the cross-entropy method (PETS and what came of it) draw actions so, around a mean that may leave the bounds
# as its spread shrinks; policies with truncated normal actions do, too. The motor is told full speed backwards.
#
# odaf draws actions by a squashed normal; it takes this function for initial weights, cut at two spreads, where it is right.
set -euo pipefail
work=$(mktemp -d)
cd "$work"
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6 scipy==1.17.1
cat > "$work/try.py" <<'PYTHON'
import sys

import jax
import numpy as np
import scipy
from scipy.stats import truncnorm

print(f"jax {jax.__version__}, scipy {scipy.__version__}; a normal of spread 0.1, cut to [-1, 1]")
far = {}
for mean in (0.9, 1.2, 1.5, 1.6, -1.6):
    low, high = (-1.0 - mean) / 0.1, (1.0 - mean) / 0.1
    draws = mean + 0.1 * np.asarray(jax.random.truncated_normal(jax.random.key(0), low, high, (10_000,)))
    right = mean + 0.1 * truncnorm.mean(low, high)
    far[mean] = float(np.mean(np.sign(draws) != np.sign(right)))
    print(f"  mean {mean:4}: expected {right:6.3f} on average, seen {draws.mean():6.3f}, from {draws.min():6.3f} to "
          f"{draws.max():6.3f}, {len(np.unique(draws)):5,} different numbers")
if not (far[0.9] == far[1.2] == 0.0 and 0.0 < far[1.5] < 0.2 and far[1.6] == far[-1.6] == 1.0):
    sys.exit("stale: it is not as described")
PYTHON
JAX_PLATFORMS=cpu "$work/venv/bin/python" -W ignore "$work/try.py"
