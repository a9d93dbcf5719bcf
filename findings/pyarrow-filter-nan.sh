#!/bin/bash
# pyarrow finds a NaN row of a Parquet file or not, depending on how many rows lie in a row group; `is_nan` is no exception.
#
# Expected: `read_table(path, filters=...)` returns the rows that the same filter finds in the table once it is in memory.
# Seen: a row group is judged by its smallest and largest value, and NaN counts for neither. Where all other rows of a group hold one
# value, pyarrow concludes that every row does, and "unlike that value" as well as `is_nan` skip the group and its NaN with it.
# "not (x <= limit)" skips it wherever all others are below the limit, "null or NaN" wherever nothing is null. In memory all of
# these find the NaN. So does the lazy reader of polars.
#
# Why it matters: sparse rewards are zero nearly everywhere, and a standing machine repeats its readings. `is_nan`, to look for
# gaps, `filters=[("reward", "!=", 0)]`, to look at what is rewarded, or `~(reward <= limit)`, to look for what is out of bounds,
# hide the broken row, and the number of rows found changes when a file is written anew with larger groups. Training then reads the
# whole file and meets the NaN.
#
# odaf never filters while reading: every column is read whole, and a NaN in it is named with its row (`data/checks`).
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check pyarrow==26.0.1 numpy==2.4.6 polars==2.1.0
"$work/venv/bin/python" - "$work/log.parquet" <<'PYTHON'
import sys

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

path = sys.argv[1]
reward = np.zeros(100_000)
reward[99_999] = 1.0  # the goal
reward[7] = np.nan  # a sensor that failed
table = pa.table({"reward": reward})
field = pc.field("reward")
filters = {
    "reward != 0": field != 0.0,
    "not (reward <= 2)": ~(field <= 2.0),
    "null or NaN": field.is_null(nan_is_null=True),
    "is_nan": pc.is_nan(field),
}
print(f"pyarrow {pa.__version__}, polars {pl.__version__}; rows found among {len(reward):,}, of which one is NaN")
seen = {}
for name, condition in filters.items():
    expected = table.filter(condition).num_rows
    counts = []
    for size in (1_000, 100_000):
        pq.write_table(table, path, row_group_size=size)
        counts.append(pq.read_table(path, filters=condition).num_rows)
    seen[name] = (expected, *counts)
    print(f"  {name:18} expected {expected}   seen {counts[0]} with groups of 1,000, {counts[1]} with one group")
pq.write_table(table, path, row_group_size=1_000)
lazy = pl.scan_parquet(path).filter(pl.col("reward") != 0.0).collect().height
print(f"  reward != 0, polars' lazy reader, groups of 1,000: {lazy}")
described = {"reward != 0": (2, 1, 2), "not (reward <= 2)": (1, 0, 0), "null or NaN": (1, 0, 0), "is_nan": (1, 0, 1)}
if seen != described or lazy != 2:
    sys.exit("stale: the numbers of rows are not as described")
PYTHON
