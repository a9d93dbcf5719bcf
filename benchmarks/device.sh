#!/usr/bin/env bash
# Measures on a machine with an accelerator and no network, from a checkout:
#
#     benchmarks/device.sh [STUDY] MINUTES [OUT]
#
# With a study, what is missing of it is trained in lanes for so many minutes; records and policies are left in
# OUT/STUDY, to be taken over elsewhere with `odaf reproduce STUDY --merge OUT/STUDY`. Without one, or with "lanes", the
# throughput of lanes is measured, what says most first, and each part left in a file OUT/lanes-PART.json: SAC-N and odaf
# with and without a fixed order of sums, lanes on twelve data sets of three robots, what pre-training takes, traces of
# 1, 64 and 400 lanes; PEERS names a folder of peers' code (see benchmarks/lanes.py), and LANES_OPTIONS goes behind the
# options of every part, such as "--lanes 2 --rows 2000" to try the script on a processor. With "resume", eight lanes are
# killed and gone on with, and their bits compared. OUT is runs/device unless it is named.
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
"$python" -c 'import jax; print("device:", jax.devices()[0].device_kind, "x", jax.device_count(), "jax", jax.__version__)'

plain=${XLA_FLAGS:-}
ordered="$plain --xla_gpu_deterministic_ops=true"  # sums in a fixed order, so that what is stopped goes on to the same bits
seconds=$(awk "BEGIN { print int(60 * $minutes) }")

measure() {  # XLA's flags, name of the part, options of benchmarks/lanes.py
  local flags=$1 part=$2 left=$((seconds - SECONDS))
  shift 2
  if [ "$left" -lt 1 ]; then
    echo "$part: no time is left"
    return
  fi
  # shellcheck disable=SC2086  # several words each
  XLA_FLAGS=$flags timeout --foreground "$left" "$python" benchmarks/lanes.py "$@" --json "$out/lanes-$part.json" \
    ${LANES_OPTIONS:-} || echo "$part: not finished; what it has is in $out/lanes-$part.json"
}

if [ "$study" = lanes ]; then
  fast=float32 both=float32
  if [ "$("$python" -c 'import jax; print(jax.default_backend())')" = gpu ]; then
    fast=tensorfloat32 both="tensorfloat32 float32"
  fi
  robots=(--learners rebrac sac-n --sizes 256 256 --critics 4 --sets 12)
  # shellcheck disable=SC2086
  {
    measure "$plain" sac-n --learners sac-n --lanes 1 64 --updates 1000 --precision $both ${PEERS:+--peers "$PEERS"}
    measure "$plain" odaf --learners odaf --lanes 16 --updates 500 --precision $both
    measure "$plain" robots "${robots[@]}" --lanes 64 --updates 1000 --precision $both
    measure "$ordered" sac-n-ordered --learners sac-n --lanes 1 64 --updates 1000 --precision $fast
    measure "$ordered" odaf-ordered --learners odaf --lanes 16 --updates 500 --precision $fast
    measure "$plain" traces "${robots[@]}" --lanes 1 64 400 --rounds 1 --precision $fast --trace "$out/traces"
    measure "$plain" course --learners odaf-locomotion --sizes 256 256 --lanes 16 --updates 100 --precision $fast --course 4000
  }
elif [ "$study" = resume ]; then
  XLA_FLAGS=$ordered timeout --foreground "${minutes}m" "$python" benchmarks/exact_resume.py | tee "$out/resume.txt"
else
  XLA_FLAGS=$ordered "$python" -m odaf reproduce "$study" --lanes --minutes "$minutes" --ledger "$out/$study" \
    --work "$out/work" --workers "$(nproc)"
fi
