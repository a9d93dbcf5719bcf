#!/bin/bash
# onnxruntime takes big-endian floats for native ones and says nothing.
#
# Expected: a NumPy array of dtype `>f4` is converted, as NumPy, SciPy and polars do, or refused, as JAX and pyarrow do.
# Seen: its type passes the check of the input ("tensor(float)"), and its bytes are read in the wrong order: 1.0 becomes 4.6e-41.
#
# Why it matters: recorders and old stations write big-endian floats; HDF5 and .npy keep the order and h5py and NumPy hand the
# array over as it is. In NumPy all is well, so means and scales are right. Then a network gets zeros and rubbish for readings, and
# gives finite actions, within bounds where they are squashed.
#
# odaf's readers bring every array into the machine's order, as does the NumPy form of `odaf export`; for its graphs, the page on the
# export says to (docs/reference/export.md).
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check onnx==1.23.2 onnxruntime==1.32.0 numpy==2.4.6 h5py==3.16.0
"$work/venv/bin/python" - "$work/log.hdf5" <<'PYTHON'
import sys

import h5py
import numpy as np
import onnxruntime
from onnx import TensorProto, helper

ends = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["n"]) for name in ("x", "y")]
graph = helper.make_graph([helper.make_node("Identity", ["x"], ["y"])], "same", ends[:1], ends[1:])
model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])

native = np.array([1.0, 2.0, 3.0], "=f4")
with h5py.File(sys.argv[1], "w") as file:
    file["readings"] = native.astype(native.dtype.newbyteorder())
with h5py.File(sys.argv[1]) as file:
    read = file["readings"][:]
print(f"onnxruntime {onnxruntime.__version__}, h5py {h5py.__version__}, numpy {np.__version__}; Identity of [1, 2, 3]")
for array in (native, read):
    seen = session.run(None, {"x": array})[0]
    print(f"  given as {array.dtype.str}, mean {array.mean()}: expected {native.tolist()}  seen {seen.tolist()}")
if not np.array_equal(read, native) or not np.array_equal(seen, native.view(read.dtype).astype("=f4")):
    sys.exit("stale: the bytes are no longer taken in the wrong order")
PYTHON
