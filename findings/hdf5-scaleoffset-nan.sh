#!/bin/bash
# HDF5's scale-offset filter turns NaN into the smallest number of its chunk.
#
# Expected: `scaleoffset=4` keeps four decimals, as promised; a NaN comes back as NaN, or the writing is refused.
# Seen: every NaN comes back as the smallest reading of the chunk that it lies in, an ordinary number; with a fill value of NaN, rows
# that were never written do too. In float32 a chunk that begins with NaN is written without a word and can never be read again. The
# same rows with gzip keep their NaN.
#
# Why it matters: of HDF5's own filters this is the one that makes noisy readings small, and missing readings are NaN. The file says that
# nothing is missing, no check for NaN will ever find the rows, and what stands there is the most extreme reading of the day.
#
# odaf uses no lossy filter where it writes, and looks for NaN in what it reads. What such a file has lost is gone before any reader
# sees it.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check h5py==3.16.0 numpy==2.4.6
"$work/venv/bin/python" - "$work/log.hdf5" <<'PYTHON'
import sys

import h5py
import numpy as np

random = np.random.default_rng(0)
readings = random.normal(size=10_000).astype(np.float32)
readings[random.random(10_000) < 0.02] = np.nan
readings[::1000] = 1.0  # no chunk begins with NaN
lost = np.isnan(readings)
chunk = {"chunks": (1000,)}
with h5py.File(sys.argv[1], "w") as file:
    file.create_dataset("gzip", data=readings, compression="gzip", **chunk)
    file.create_dataset("scaleoffset", data=readings, scaleoffset=4, **chunk)
    part = file.create_dataset("unwritten", 1000, np.float32, scaleoffset=4, fillvalue=np.nan, **chunk)
    part[:500] = readings[:500]
    begun = np.where(np.arange(1000) == 0, np.nan, readings[:1000]).astype(np.float32)
    file.create_dataset("begun", data=begun, scaleoffset=4, **chunk)
with h5py.File(sys.argv[1]) as file:
    back = {name: file[name][:] for name in ("gzip", "scaleoffset", "unwritten")}
    try:
        begun = f"seen {np.isnan(file['begun'][:]).sum()}"
    except OSError as error:
        begun = f"seen {type(error).__name__}: {error}"
print(f"h5py {h5py.__version__}, HDF5 {h5py.version.hdf5_version}, numpy {np.__version__}")
print(f"NaN among 10,000 readings, expected {lost.sum()}")
for name in ("gzip", "scaleoffset"):
    error = np.abs(back[name] - readings)[~lost].max()
    print(f"  {name:12} seen {np.isnan(back[name]).sum():3}; largest error of the other readings {error:.0e}")
smallest = np.repeat(np.nanmin(readings.reshape(-1, 1000), axis=1), 1000)
same = np.allclose(back["scaleoffset"][lost], smallest[lost], atol=1e-4)
print(f"  they became {np.unique(back['scaleoffset'][lost])[:3]} ...: the smallest reading of each chunk: {same}")
tail = back["unwritten"][500:]
print(f"500 rows never written, fill value NaN: expected 500 NaN, seen {np.isnan(tail).sum()}, all {tail[0]:.4f}")
print(f"a chunk that begins with NaN: expected {np.isnan(readings[1:1000]).sum() + 1} NaN, {begun}")
kept = np.isnan(back["gzip"]).sum() == lost.sum()
if not kept or np.isnan(back["scaleoffset"]).any() or not same or np.isnan(tail).any() or "OSError" not in begun:
    sys.exit("stale: NaN does not become the smallest reading of its chunk")
PYTHON
