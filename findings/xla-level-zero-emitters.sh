#!/bin/bash
# XLA on processors: at optimisation level 0 a small training program still takes three times as long to compile as it need.
#
# Expected: --xla_backend_optimization_level=0 with --xla_llvm_disable_expensive_passes=true, the usual advice for tests that compile much
# and compute little, is as quick as compiling gets.
# Seen: the two flags halve the time, and two thirds of what is left go into the emitters of fused operations, which the level leaves
# as they are. --xla_cpu_use_fusion_emitters=false beside them brings it to a sixth of the default's.
# At the default level that flag is no bargain: programs compile sooner too, and run slower (a TD3+BC update by a quarter).
#
# Why it matters: test suites of JAX libraries are mostly compiling. Ours takes 17.4 minutes of processor in place of 22.6.
# Compiling is told by processor time, the least of five, so that other work on the machine matters little.
set -euo pipefail
work=$(mktemp -d)
cd "$work"
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6
cat > compiled.py <<'PYTHON'
import time

import jax
import jax.numpy as jnp


def values(layers, rows):
    for weight, bias in layers:
        rows = rows @ weight + bias
        rows = jax.nn.relu((rows - rows.mean(-1, keepdims=True)) * jax.lax.rsqrt(rows.var(-1, keepdims=True) + 1e-5))
    return rows.sum(-1)


def update(state, rows, targets):
    parameters, slow, first, second = state
    slope = jax.grad(lambda own: jnp.mean((jax.vmap(values, (0, None))(own, rows) - targets) ** 2))(parameters)
    first = jax.tree.map(lambda m, g: 0.9 * m + 0.1 * g, first, slope)
    second = jax.tree.map(lambda v, g: 0.999 * v + 0.001 * g * g, second, slope)
    parameters = jax.tree.map(lambda p, m, v: p - 3e-4 * m / (jnp.sqrt(v) + 1e-8), parameters, first, second)
    return parameters, jax.tree.map(lambda s, p: s + 0.005 * (p - s), slow, parameters), first, second


def seconds(width):
    shapes = [(6, width), (width, width), (width, 4)]
    layers = [(jnp.ones((3, *shape)), jnp.ones((3, shape[1]))) for shape in shapes]
    arguments = (layers, layers, layers, layers), jnp.ones((8, 6)), jnp.ones((3, 8))
    lowered = jax.jit(update).lower(*arguments)
    start = time.process_time()
    lowered.compile()
    return time.process_time() - start


seconds(4)
print(min(seconds(width) for width in (5, 6, 7, 8, 9)))
PYTHON
level="--xla_backend_optimization_level=0 --xla_llvm_disable_expensive_passes=true"
seconds() { JAX_ENABLE_COMPILATION_CACHE=false XLA_FLAGS="$1" "$work/venv/bin/python" compiled.py; }
"$work/venv/bin/python" - "$(seconds "")" "$(seconds "$level")" "$(seconds "$level --xla_cpu_use_fusion_emitters=false")" <<'PYTHON' || { echo "stale"; exit 1; }
import sys
from importlib.metadata import version

usual, level, without = map(float, sys.argv[1:])
print(f"jax {version('jax')}, jaxlib {version('jaxlib')}: seconds to compile one update of three small critics")
print(f"as it comes {usual:.2f}; level 0 {level:.2f}; level 0 without the emitters {without:.2f}")
print(f"expected: level 0 leaves nothing to save; seen: {level / without:.1f} times as long as without the emitters")
sys.exit(not level > 1.4 * without)
PYTHON
