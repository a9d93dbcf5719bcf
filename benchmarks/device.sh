#!/usr/bin/env bash
# Measures on a machine with an accelerator and no network, from a checkout:
#
#     benchmarks/device.sh [STUDY] MINUTES [OUT]
#
# With a study, what is missing of it is trained in lanes for so many minutes; records and policies are left in
# OUT/STUDY, to be taken over elsewhere with `odaf reproduce STUDY --merge OUT/STUDY`. Without one, or with "lanes", the
# throughput of lanes is measured and left in OUT/lanes.json (PEERS names a folder of peers' code, see benchmarks/lanes.py).
# With "resume", eight lanes are killed and gone on with, and their bits compared. OUT is runs/device unless it is named.
#
# Large sets of your own travel in half precision: `odaf data convert FILE --to odaf --precision half --out HALF.h5`, and
# train on HALF.h5 there and here.
#
# Python packages that are not installed there come from a folder `wheels` beside the checkout, filled before with
#     pip download -r requirements.lock "jax[cuda13]" -d wheels
set -euo pipefail
cd "$(dirname "$0")/.."

study=lanes
case "${1:-}" in ''|*[!0-9.]*) study=${1:-lanes}; shift || true ;; esac
minutes=${1:?"usage: benchmarks/device.sh [STUDY] MINUTES [OUT]"}
out=${2:-runs/device}
python=${PYTHON:-python3}
mkdir -p "$out"

if ! "$python" -c 'import jax, equinox, optax, jaxtyping, polars, h5py, scipy, tyro, rich' 2>/dev/null; then
  wheels=${WHEELS:-../wheels}
  test -d "$wheels" || { echo "packages are missing, and there is no folder of wheels at $wheels (WHEELS names another)" >&2; exit 2; }
  "$python" -m pip install --quiet --no-index --find-links "$wheels" "jax[cuda13]" equinox optax jaxtyping polars h5py scipy tyro rich \
    "gymnasium[mujoco]" gymnasium-robotics
fi
export PYTHONPATH="$PWD/src${PYTHONPATH:+:$PYTHONPATH}"
# Sums in a fixed order, so that what is stopped goes on to the same bits.
export XLA_FLAGS="${XLA_FLAGS:-} --xla_gpu_deterministic_ops=true"
"$python" -c 'import jax; print("device:", jax.devices()[0].device_kind, "x", jax.device_count(), "jax", jax.__version__)'

if [ "$study" = lanes ]; then
  timeout --foreground "${minutes}m" "$python" benchmarks/lanes.py --lanes 1 4 16 64 --updates 1000 --course 20000 \
    ${PEERS:+--peers "$PEERS"} --json "$out/lanes.json"
elif [ "$study" = resume ]; then
  timeout --foreground "${minutes}m" "$python" benchmarks/exact_resume.py | tee "$out/resume.txt"
else
  "$python" -m odaf reproduce "$study" --lanes --minutes "$minutes" --ledger "$out/$study" --work "$out/work" \
    --workers "$(nproc)"
fi
