#!/bin/bash
# polars' rolling correlation of two float32 columns is 29, or -162,000.
#
# Expected: a correlation lies between -1 and 1; over a window it is what `corr` says of the rows in the window.
# Seen: `rolling_corr` works from sums of squares in the columns' own type. For float32 readings around 1,000 that spread by 1 it is off by
# 0.2, around 10,000 it is beyond 1 half of the time and around a million it has six digits before the point. No NaN, no warning. `corr` on
# the same rows is right, so is `rolling_std`. In float64 the same happens around a hundred million: 5.
#
# Why it matters: a window's correlation between what was asked for and what was measured shows when a sensor or an actuator begins to
# drift, and logs keep readings as float32: pressures in pascal, encoder counts, positions in millimetres. The numbers
# that are only off by a tenth are the ones nobody notices.
#
# odaf computes no rolling statistics.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check polars==2.1.0 numpy==2.4.6
"$work/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
import polars as pl

random = np.random.default_rng(0)
window, rows = 50, 2_000
first = random.normal(size=rows)
second = first / 2 + random.normal(size=rows)
rolling = pl.rolling_corr("first", "second", window_size=window)
print(f"polars {pl.__version__}, numpy {np.__version__}; correlation over {window} rows of two columns that spread by about 1")
errors, outside = {}, {}
for offset, kind in ((0, np.float32), (1e3, np.float32), (1e4, np.float32), (1e6, np.float32), (1e6, np.float64), (1e8, np.float64)):
    frame = pl.DataFrame({"first": (offset + first).astype(kind), "second": (offset + second).astype(kind)})
    seen = frame.select(rolling).to_series().to_numpy()[window - 1 :]
    pairs = np.lib.stride_tricks.sliding_window_view(frame.to_numpy().astype(np.float64), window, axis=0)
    true = np.array([np.corrcoef(pair)[0, 1] for pair in pairs])
    last = frame.tail(window).select(pl.corr("first", "second")).item() - true[-1]
    case = f"{kind.__name__}, around {offset:,.0f}"
    errors[case], outside[case] = np.abs(seen - true).max(), np.mean(np.abs(seen) > 1)
    print(f"  {case:26} expected {true.min():.2f} to {true.max():.2f}  seen {seen.min():.2f} to {seen.max():.2f},", end=" ")
    print(f"{outside[case]:.0%} outside [-1, 1]; corr on the last window off by {abs(last):.0e}")
described = (
    errors["float32, around 0"] < 1e-3
    and errors["float64, around 1,000,000"] < 1e-2
    and errors["float32, around 1,000"] > 0.05
    and outside["float32, around 10,000"] > 0.05
    and outside["float32, around 1,000,000"] > 0.05
)
if not described:
    sys.exit("stale: the correlations are as they should be, or others than described")
PYTHON
