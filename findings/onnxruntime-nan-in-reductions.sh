#!/bin/bash
# onnxruntime's ReduceMax, ReduceMin, ArgMax and ArgMin see a NaN only where it stands first.
#
# Expected: the largest of numbers of which one is NaN is NaN, wherever it stands, as in NumPy and JAX; argmax names its place.
# Seen: with the NaN in the first place, that; in any other place it is passed over, and the answer is an ordinary number (processor
# provider, x86-64, along rows as along columns). ReduceSum, ReduceMean, Max, Min, Clip, Relu, Tanh and Sigmoid hand a NaN on.
#
# Why it matters: "is the largest reading finite?" is a usual guard in front of a policy, and "which candidate does the critic value
# most?" the last step of one that ranks candidates. A test with the NaN in the first column passes. With a broken sensor in any other
# column the guard says that all is well.
#
# The graphs of `odaf export` ask IsNaN and IsInf of every reading before anything else (`deployment/policies.py`).
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check onnx==1.23.2 onnxruntime==1.32.0 numpy==2.4.6
"$work/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
import onnxruntime
from onnx import TensorProto, helper


def places_seen(kind, attributes, width=8):
    """Where a NaN among so many numbers makes the answer NaN, or its own place."""
    answer = TensorProto.INT64 if kind.startswith("Arg") else TensorProto.FLOAT
    ends = [
        helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, width]),
        helper.make_tensor_value_info("y", answer, [1, 1]),
    ]
    graph = helper.make_graph([helper.make_node(kind, ["x"], ["y"], **attributes)], kind, ends[:1], ends[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    seen = []
    for place in range(width):
        x = np.linspace(-1, 1, width, dtype=np.float32)[None]
        x[0, place] = np.nan
        y = session.run(None, {"x": x})[0].item()
        if y == place if kind.startswith("Arg") else np.isnan(y):
            seen.append(place)
    return seen


print(f"onnxruntime {onnxruntime.__version__}; one NaN among eight numbers, expected to be seen in all places 0 to 7")
found = {}
for kind in ("ReduceMax", "ReduceMin", "ArgMax", "ArgMin", "ReduceMean"):
    found[kind] = places_seen(kind, {"axis": 1} if kind.startswith("Arg") else {"axes": [1]})
    print(f"  {kind:10} sees it in {found[kind]}")
if found.pop("ReduceMean") != list(range(8)) or any(places != [0] for places in found.values()):
    sys.exit("stale: a NaN is seen in other places than it was")
PYTHON
