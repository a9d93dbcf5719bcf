#!/bin/bash
# Ant-v5's first observation of an episode holds no rotation: its quaternion has a length from 0.91 to 1.10, from MuJoCo 3.2.0 on.
#
# Expected: qpos holds unit quaternions whenever somebody looks at it, so an observation that is a copy of qpos does too. A reset that
# adds noise to all of qpos leaves it to `mj_forward`, which it calls afterwards.
# Seen: up to 3.1.6 `mj_forward` normalises the quaternions of qpos in place. From 3.2.0 on it normalises a copy for its own use, and qpos
# keeps what the reset wrote; the first `mj_step` makes it a unit. So with one gymnasium the first observation of every
# episode of Ant is a kind that occurs nowhere else in it, and with an older MuJoCo it is not.
#
# Why it matters: public logs of ants were recorded before. A policy learned from them begins every evaluation at a state that the log
# does not hold (orientations computed from it are scaled, not turned), and a log recorded today gives dynamics models one transition an
# episode in which the quaternion jumps to length one by itself. Nothing is said and nothing fails: the torso stands where it should.
#
# odaf's ant mazes normalise the quaternion at the reset, as the public data have it; Hopper, HalfCheetah and Walker2d have none.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
for version in 3.1.6 3.2.0 4.0.0; do
    python3 -m venv "$work/$version"
    "$work/$version/bin/python" -m pip install -qq --disable-pip-version-check \
        "mujoco==$version" gymnasium==1.3.0 numpy==2.4.6 imageio==2.37.0 packaging==25.0
    "$work/$version/bin/python" -W ignore - "$version" <<'PYTHON'
import sys

import gymnasium
import mujoco
import numpy as np

environment = gymnasium.make("Ant-v5")
first, second = [], []
for seed in range(100):
    observation, _ = environment.reset(seed=seed)
    first.append(np.linalg.norm(observation[1:5]))
    second.append(np.linalg.norm(environment.step(np.zeros(8))[0][1:5]))
print(f"mujoco {mujoco.__version__}, gymnasium {gymnasium.__version__}: lengths of the torso's quaternion in 100 episodes of Ant-v5")
print(f"  first observation {min(first):.3f} to {max(first):.3f}, second {min(second):.3f} to {max(second):.3f}")
is_unit = np.allclose(first, 1.0, atol=1e-9)
if is_unit != (sys.argv[1] == "3.1.6") or not np.allclose(second, 1.0, atol=1e-9):
    sys.exit("stale: quaternions are no longer as described")
PYTHON
done
