#!/bin/bash
# onnxruntime's Tanh of float32 is larger than one.
#
# Expected: |tanh(x)| <= 1. JAX gives exactly 1 from 8 on, and neither it nor NumPy ever gives more.
# Seen: 1.0000002, the next number above one, for a good part of the inputs between 8.2 and 9, -1.0000002 for the negative ones
# (processor provider, x86-64). The model holds one node, Tanh, so no optimisation of the graph is at work.
#
# Why it matters: a squashed policy saturates where the log does. Exported to ONNX, its action lies outside the bounds that it was
# trained with: gymnasium's `Box.contains` says no, `arctanh` gives NaN, and so does the log density of a squashed Gaussian, whose
# correction is log(1 - a^2).
#
# The graphs of `odaf export` cut what comes of Tanh, and the action once more to the bounds (`deployment/onnx_form.py`).
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check \
    onnx==1.23.2 onnxruntime==1.32.0 numpy==2.4.6 jax==0.10.2 jaxlib==0.10.2 gymnasium==1.4.0
JAX_PLATFORMS=cpu "$work/venv/bin/python" - <<'PYTHON'
import sys

import gymnasium
import jax
import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper

ends = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n"]) for name in ("x", "y")]
graph = helper.make_graph([helper.make_node("Tanh", ["x"], ["y"])], "tanh", ends[:1], ends[1:])
model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])

x = np.linspace(-20, 20, 4_000_001, dtype=np.float32)
results = {
    f"numpy {np.__version__}": np.tanh(x),
    f"jax {jax.__version__}": np.asarray(jax.numpy.tanh(x)),
    f"onnxruntime {onnxruntime.__version__} (onnx {onnx.__version__})": session.run(None, {"x": x})[0],
}
print("largest |tanh(x)| for x of -20 to 20, expected 1.0")
for name, y in results.items():
    print(f"  {name:35} {np.abs(y).max()!s:10} above one: {np.mean(np.abs(y) > 1):.2%}")
*others, y = results.values()
at = np.abs(x[np.abs(y) > 1])
if not len(at) or any(np.abs(other).max() > 1 for other in others):
    sys.exit("stale: onnxruntime's tanh stays within one, or another one does not")
print(f"  |x| from {at.min()} to {at.max()}")
box = gymnasium.spaces.Box(-1, 1, (1,), np.float32)
print(f"  such an action is in Box(-1, 1): {box.contains(y[np.abs(y) > 1][:1])}; arctanh: ", end="")
with np.errstate(invalid="ignore"):
    print(np.arctanh(y[np.abs(y) > 1][0]))
PYTHON
