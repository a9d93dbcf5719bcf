#!/bin/bash
# jax.random.choice with probabilities can never draw one of six rows of a log of ten million.
#
# Expected: with equal probabilities `choice(key, n, shape, p=p)` draws like `randint(key, shape, 0, n)`. Of n rows, 4 n draws leave
# out a share of exp(-4) = 1.8 %, and 8 n draws 0.03 %.
# Seen: the share stops at about 16 %. Each draw looks up one float32 uniform number in the running sum of p, and there are
# 2^23 = 8.4 million such numbers: n - 2^23 rows can be reached by none, with any key. No warning. `randint` does as expected;
# so does `choice` in double precision (JAX_ENABLE_X64 and a float64 p).
#
# Why it matters: this is how weighted or prioritised batches are drawn on the device, and logs of ten million steps are common.
# Well below that size rows still get unequal shares: among a million, some own 8 of the numbers and some 9.
#
# odaf draws rows with `randint` (`data/sampling.py`); a mixture first draws the part, then a row of it with `randint`.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6
JAX_PLATFORMS=cpu JAX_ENABLE_X64=1 "$work/venv/bin/python" - <<'PYTHON'
import math
import sys

import jax
import jax.numpy as jnp
import numpy as np

rows, rounds = 10_000_000, 8
single, double = (jnp.full(rows, 1 / rows, kind) for kind in (jnp.float32, jnp.float64))
ways = {
    "choice, p of float32": jax.jit(lambda key: jax.random.choice(key, rows, (rows,), p=single)),
    "choice, p of float64": jax.jit(lambda key: jax.random.choice(key, rows, (rows,), p=double)),
    "randint": jax.jit(lambda key: jax.random.randint(key, (rows,), 0, rows)),
}
print(f"jax {jax.__version__}, {rows:,} rows; share of rows never drawn")
print(f"  least possible with 2^23 different numbers: {1 - 2**23 / rows:.4f}")
left = {}
for name, draw in ways.items():
    seen = np.zeros(rows, bool)
    for number in range(rounds):
        seen[np.asarray(draw(jax.random.key(number)))] = True
        if number + 1 in (4, rounds):
            left[name] = 1 - seen.mean()
            print(f"  {name:21} {number + 1} n draws: expected {math.exp(-number - 1):.4f}  seen {left[name]:.4f}", flush=True)
if left["choice, p of float32"] < 0.15 or max(left["choice, p of float64"], left["randint"]) > 0.001:
    sys.exit("stale: the shares are not as described")
PYTHON
