#!/bin/bash
# A policy quantised with onnxruntime acts by what the other rows of its batch are.
#
# Expected: an int8 policy is a little coarser than the float one; each row of a batch gets the action that it would get alone.
# Seen: `quantize_dynamic` puts one scale on the whole table of readings, taken from its largest entry at each call. One machine of a batch
# whose first reading is 100 moves the actions of its neighbour; at 1,000 the neighbour's own readings all round to nothing, and its
# action is another one altogether, of the other sign. In the float graph it stays as it was.
#
# Why it matters: one machine at a time, as in a first trial, nothing shows. A fleet that shares a session, or a simulation of many,
# couples its members: one broken sensor takes the control from all, with actions that are finite and within bounds. Scores depend on
# the size of the batch.
#
# `odaf export` has no int8 form; the page on the export says why (docs/reference/export.md).
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check onnx==1.23.2 onnxruntime==1.32.0 numpy==2.4.6
"$work/venv/bin/python" - "$work" <<'PYTHON'
import logging
import sys

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper, numpy_helper
from onnxruntime.quantization import QuantType, quantize_dynamic

logging.disable(logging.WARNING)
random = np.random.default_rng(0)
weights = {
    "first": random.normal(size=(8, 32)).astype(np.float32) / 3,
    "bias": random.normal(size=32).astype(np.float32) / 2,
    "second": random.normal(size=(32, 2)).astype(np.float32) / 6,
}
nodes = [
    helper.make_node("MatMul", ["readings", "first"], ["product"]),
    helper.make_node("Add", ["product", "bias"], ["sum"]),
    helper.make_node("Relu", ["sum"], ["hidden"]),
    helper.make_node("MatMul", ["hidden", "second"], ["raw"]),
    helper.make_node("Tanh", ["raw"], ["action"]),
]
sizes = {"readings": ["n", 8], "action": ["n", 2]}
ends = [helper.make_tensor_value_info(name, TensorProto.FLOAT, size) for name, size in sizes.items()]
given = [numpy_helper.from_array(array, name) for name, array in weights.items()]
graph = helper.make_graph(nodes, "policy", ends[:1], ends[1:], given)
path = f"{sys.argv[1]}/policy.onnx"
onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
quantize_dynamic(path, f"{path}.int8", weight_type=QuantType.QInt8)
sessions = {name: onnxruntime.InferenceSession(path + end) for name, end in (("float32", ""), ("int8", ".int8"))}
readings = random.normal(size=(1, 8)).astype(np.float32)
print(f"onnxruntime {onnxruntime.__version__}, onnx {onnx.__version__}; action of one machine, by its neighbour's first reading")
moved = {}
for name, session in sessions.items():
    alone, zeros = (session.run(None, {"readings": rows})[0][0] for rows in (readings, 0 * readings))
    print(f"  {name:7} alone {alone}; of zeros {zeros}")
    for reading in (1, 100, 1_000):
        neighbour = readings.copy()
        neighbour[0, 0] = reading
        seen = session.run(None, {"readings": np.concatenate([readings, neighbour])})[0][0]
        moved[name, reading] = np.abs(seen - alone).max()
        print(f"  {name:7} beside {reading:5}: expected {alone}  seen {seen}")
if moved["float32", 1_000] > 1e-6 or moved["int8", 100] < 0.01 or moved["int8", 1_000] < 0.1:
    sys.exit("stale: the neighbour's reading does not move the action as described")
PYTHON
