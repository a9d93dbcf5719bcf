#!/bin/bash
# A transposed NumPy array saved with safetensors 0.8.0 comes back with its numbers in other places.
#
# Expected: `load(save({"w": w}))["w"]` equals `w`, whatever the strides of `w`; or an error, as safetensors.torch gives.
# Seen: 0.8.0 takes the memory of the array as it lies and writes the shape of the view beside it. A transposed matrix, a slice with
# a step and a matrix in Fortran order lose their meaning without a word; the shape is right, so the reader sees nothing either.
# 0.7.0 wrote all of them correctly. The docstring has long asked for contiguous arrays, but nothing checks it.
#
# Why it matters: whoever brings a network over from a library whose linear layers are (out, in) writes `weight.T`. The policy
# loads, its actions are finite and within bounds, and it is another policy. A log in Fortran order (MATLAB, scikit-learn,
# `DataFrame.to_numpy`) is scrambled in the same way.
#
# odaf writes this layout with code of its own, which copies every array into row order (`training/tensors.py`). It cannot tell that
# a file which something else wrote with safetensors 0.8.0 was scrambled: the shapes are right, and the layout has no sums.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
cat > "$work/try.py" <<'PYTHON'
import sys
from importlib.metadata import version

import numpy as np
from safetensors.numpy import load, save

numbers = np.arange(6, dtype=np.float32).reshape(2, 3)
arrays = {
    "row order": numbers,
    "transposed": numbers.T,
    "every second": np.arange(6, dtype=np.float32)[::2],
    "Fortran order": np.asfortranarray(numbers),
}
wrong = []
print(f"safetensors {version('safetensors')}, numpy {np.__version__}")
for name, array in arrays.items():
    back = load(save({"w": array}))["w"]
    same = np.array_equal(array, back)
    print(f"  {name:13}  expected {array.tolist()}  seen {back.tolist()}  {'same' if same else 'DIFFERENT'}")
    if not same:
        wrong.append(name)
expected = [] if sys.argv[1] == "right" else ["transposed", "every second", "Fortran order"]
if wrong != expected:
    sys.exit(f"stale: {wrong} came back different, not {expected}")
PYTHON
for case in 0.7.0:right 0.8.0:wrong; do
    "$work/venv/bin/python" -m pip install -qq --disable-pip-version-check "safetensors==${case%:*}" numpy==2.4.6
    "$work/venv/bin/python" "$work/try.py" "${case#*:}"
done
