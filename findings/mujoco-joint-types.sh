#!/bin/bash
# From MuJoCo 3.12.0 on `mjtJoint.mjJNT_HINGE == model.jnt_type[0]` is False for a hinge, and turned round it is True.
#
# Expected: equality does not depend on the side, and `model.jnt_type[i] in (mjJNT_HINGE, mjJNT_SLIDE)` finds hinges and slides.
# Seen: the constant compares unequal to every NumPy integer, such as each entry of the model's arrays. Comparing whole arrays or
# Python integers still works. `in` asks the constants in the tuple, so it is False for every joint, without a word.
# gymnasium-robotics 1.4.2 asks so in an assertion: Fetch, HandReach and FrankaKitchen raise an AssertionError with no text.
# Nothing in its requirements forbids MuJoCo 3.12, and `pip check` is content.
#
# Why it matters: code that looks for the joints of a body, to say which readings are angles or to set a state from a log, finds
# none. Tasks of Minari's Fetch and Kitchen data cannot be played, and the error does not say why.
#
# odaf compares no such constants. Where such a task cannot be made, it names the versions that work
# (`environments/gymnasium_environment.py`).
set -euo pipefail
work=$(mktemp -d)
cd "$work"
trap 'rm -rf "$work"' EXIT
cat > "$work/try.py" <<'PYTHON'
import sys

import gymnasium
import gymnasium_robotics
import mujoco
import numpy as np

gymnasium.logger.min_level = gymnasium.logger.ERROR
gymnasium.register_envs(gymnasium_robotics)
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><body><joint/><geom size='.1'/></body></worldbody></mujoco>")
kind, hinge = model.jnt_type[0], mujoco.mjtJoint.mjJNT_HINGE
seen = {
    "entry == constant": bool(kind == hinge),
    "constant == entry": bool(hinge == kind),
    "entry in (constant,)": kind in (hinge,),
    "int(entry) in (constant,)": int(kind) in (hinge,),
}
for name in ("FetchReach-v4", "HandReach-v3", "FrankaKitchen-v1", "PointMaze_UMaze-v3"):
    try:
        gymnasium.make(name).reset(seed=0)
        seen[name] = True
    except AssertionError as error:
        seen[name] = False
        print(f"  {name}: AssertionError with the text {str(error)!r}")
print(f"mujoco {mujoco.__version__}, gymnasium-robotics 1.4.2, numpy {np.__version__}; expected True for all")
print("\n".join(f"  {name:26} seen {value}" for name, value in seen.items()))
wrong = [name for name, value in seen.items() if not value]
described = ["constant == entry", "entry in (constant,)", "FetchReach-v4", "HandReach-v3", "FrankaKitchen-v1"]
if wrong != (described if sys.argv[1] == "3.12.0" else []):
    sys.exit(f"stale: False are {wrong}")
PYTHON
for version in 3.11.0 3.12.0; do
    python3 -m venv "$work/$version"
    "$work/$version/bin/python" -m pip install -qq --disable-pip-version-check \
        "mujoco==$version" gymnasium==1.4.0 gymnasium-robotics==1.4.2 numpy==2.4.6
    "$work/$version/bin/python" -m pip check
    "$work/$version/bin/python" -W ignore "$work/try.py" "$version" 2> /dev/null
done
