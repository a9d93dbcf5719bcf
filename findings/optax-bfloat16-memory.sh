#!/bin/bash
# optax's Adam on bfloat16 weights never forgets a large gradient: its decay of 0.999 is 1.
#
# Expected: in bfloat16 everything is coarser, and the second moment still has a memory of some thousand steps, as its decay says. After
# one gradient ten thousand times as large as the rest, steps are small for a while and then as before.
# Seen: the second moment stands still for ever, to the bit, and steps stay a few hundred times smaller than in float32. 0.999 is rounded
# to the type of the moment, and the bfloat16 nearest to it is 1.0. `mu_dtype=float32` is for the first moment only and changes
# nothing. With a decay of 0.99, which bfloat16 can tell from 1, it forgets.
#
# Why it matters: critics meet such gradients, from one broken reward or in the first steps. The loss then falls hardly any more and nothing
# is NaN; half the memory was bought with a learning rate of almost nothing. Whoever compares the two types sees a worse
# result and blames the eight bits of the weights.
#
# odaf keeps weights and moments in float32; its bfloat16 is for the factors of a matrix product alone.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check optax==0.2.8 jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6
JAX_PLATFORMS=cpu "$work/venv/bin/python" - <<'PYTHON'
import sys

import jax
import jax.numpy as jnp
import optax

rate, after = 0.01, 20_000


def run(kind, **settings):
    """The second moment after the large gradient and after many small ones, and the size of the last step."""
    adam = optax.adam(rate, **settings)
    state = adam.init(jnp.ones((), kind))
    _, state = adam.update(jnp.asarray(100, kind), state)
    first = state[0].nu

    def step(state, _):
        change, state = adam.update(jnp.asarray(0.01, kind), state)
        return state, change

    state, changes = jax.jit(lambda state: jax.lax.scan(step, state, length=after))(state)
    return float(first), float(state[0].nu), abs(float(changes[-1]))


cases = {
    "float32": run(jnp.float32),
    "bfloat16": run(jnp.bfloat16),
    "bfloat16, mu_dtype=float32": run(jnp.bfloat16, mu_dtype=jnp.float32),
    "bfloat16, b2=0.99": run(jnp.bfloat16, b2=0.99),
}
print(f"jax {jax.__version__}, optax {optax.__version__}; one gradient of 100, then {after:,} of 0.01; Adam with a rate of {rate}")
print(f"0.999 in bfloat16: {float(jnp.asarray(0.999, jnp.bfloat16))}; in the end expected a second moment of 0.0001 and steps of {rate}")
for name, (first, last, size) in cases.items():
    print(f"  {name:27} seen second moment {first:.3g}, then {last:.3g}; last step {size:.2g}")
stuck = all(cases[name][0] == cases[name][1] and cases[name][2] < rate / 100 for name in list(cases)[1:3])
if not stuck or cases["float32"][2] < 0.9 * rate or cases["bfloat16, b2=0.99"][1] > 0.01:
    sys.exit("stale: the second moment does not stand still as described")
PYTHON
