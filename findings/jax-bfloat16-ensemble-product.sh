#!/bin/bash
# On a processor, JAX multiplies bfloat16 matrices with float32 sums for one order of the axes and stops for another.
#
# Expected: jnp.einsum(..., preferred_element_type=jnp.float32) takes bfloat16 factors in any order of axes, as it takes float16 and float32.
# Seen: members of an ensemble first (kbi,kio->kbo) works; rows first in factor and result (bki,kio->bko) stops with "UNIMPLEMENTED:
# Unsupported element type for DotThunk::Execute: BF16 x BF16 = F32". With rows first in the factor alone it works again, and so do
# float16 and a bfloat16 result.
#
# Why it matters: ensembles of critics with 16-bit products are written for GPUs and tried and tested on processors, and which order their
# products have is a matter of how batches are drawn.
#
# odaf rounds to bfloat16 in 32-bit numbers on processors.
set -euo pipefail
work=$(mktemp -d)
cd "$work"
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6
cat > "$work/try.py" <<'PYTHON'
import sys

import jax
import jax.numpy as jnp

WRONG = "Unsupported element type"
print(f"jax {jax.__version__}, on a {jax.default_backend()}; sums in float32")


def says(run, *factors):
    try:
        return str(jax.block_until_ready(jax.jit(run)(*factors)).dtype)
    except jax.errors.JaxRuntimeError as error:
        return str(error)


def product(equation):
    return lambda rows, weights: jnp.einsum(equation, rows, weights, preferred_element_type=jnp.float32)


found = {}
for dtype in (jnp.bfloat16, jnp.float16, jnp.float32):
    weights = jnp.ones((3, 6, 8), dtype)
    for equation, shape in (("kbi,kio->kbo", (3, 7, 6)), ("bki,kio->kbo", (7, 3, 6)), ("bki,kio->bko", (7, 3, 6))):
        found[dtype, equation] = says(product(equation), jnp.ones(shape, dtype), weights)
        print(f"  {dtype.__name__:8} {equation}: {found[dtype, equation]}")
stops = [key for key, said in found.items() if WRONG in said]
if stops != [(jnp.bfloat16, "bki,kio->bko")]:
    sys.exit("stale: it is not as described")
PYTHON
JAX_PLATFORMS=cpu "$work/venv/bin/python" -W ignore "$work/try.py"
