#!/bin/bash
# polars sums float32 by groups one row after the other; asking for the median too makes the sum right.
#
# Expected: a sum of float32 is good to a few parts in a million, as `frame["reward"].sum()` is; the groups of a group_by are no exception.
# Seen: four groups of 2.5 million equal rows get four different sums, up to 2 % off, and from 30 million rows on one third is missing,
# since adding 0.1 to 2,097,152 changes nothing. The mean in the same answer is right, so that sum and mean times count disagree. With a
# median or a product asked for along with it, or groups known to be sorted, the sum is right; with more threads it is another one.
#
# Why it matters: returns by episode, by operator or by day are such sums, and logs keep rewards as float32. The column alone, a window
# (`over`) and a frame for each group are all right, so a check on one part finds nothing. The wrong sums are of a believable size.
#
# odaf reads tables with polars and computes nothing there: returns and statistics are summed in float64 by code of its own.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check polars==2.1.0 numpy==2.4.6
POLARS_MAX_THREADS=1 "$work/venv/bin/python" - <<'PYTHON'
import sys

import numpy as np
import polars as pl


def frame(rows, groups):
    episode = np.arange(rows) // (rows // groups)
    return pl.DataFrame({"episode": episode.astype(np.int32), "reward": np.full(rows, 0.1, np.float32)})


reward, each = pl.col("reward"), 2_500_000
log = frame(4 * each, 4)
ways = {
    "sum": [reward.sum()],
    "sum, with the mean": [reward.sum(), reward.mean().alias("mean")],
    "sum, with the median": [reward.sum(), reward.median().alias("median")],
}
print(f"polars {pl.__version__}, numpy {np.__version__}; returns of four episodes of {each:,} rewards of 0.1, expected 250,000 each")
seen = {}
for name, what in ways.items():
    answer = log.group_by("episode", maintain_order=True).agg(*what)
    seen[name] = np.abs(answer["reward"].to_numpy() / (each * 0.1) - 1).max()
    print(f"  {name:21} seen {answer['reward'].to_list()}")
    if "mean" in answer.columns:
        print(f"  {'the mean itself':21} seen {answer['mean'].to_list()}")
whole = log["reward"].sum() / (4 * each * 0.1) - 1
print(f"  {'the column at once':21} expected {4 * each * 0.1}  seen {log['reward'].sum()}")
long = frame(30_000_000, 1).group_by("episode").agg(reward.sum())["reward"].item()
print(f"one episode of 30 million rows: expected 3,000,000, seen {long:,.0f}")
right = seen["sum, with the median"] < 1e-5 and abs(whole) < 1e-5
if not right or min(seen["sum"], seen["sum, with the mean"]) < 1e-3 or long > 2_200_000:
    sys.exit("stale: sums by groups are other ones than described")
PYTHON
