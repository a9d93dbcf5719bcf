#!/bin/bash
# `pip install mujoco==4.0.0` over an older MuJoCo leaves one that cannot be imported, and gymnasium says that there is none.
#
# Expected: an upgrade leaves a package that works, or pip fails.
# Seen: pip ends with 0 and `pip check` is content, but `import mujoco` raises ImportError. From 4.0.0 on the compiled part is a package of
# its own, mujoco-core, with files in the same folder. pip installs that first and then removes the files of the old mujoco, of which
# some have the same names. gymnasium turns the error, which names the repair, into "MuJoCo is not installed".
#
# Why it matters: a policy is learnt for hours, the simulator is upgraded in the same environment, and the evaluation says to install
# what `pip list` shows. A fresh environment has no such trouble.
#
# odaf's lock file is installed into a fresh environment (`make test`), where 4.0.0 works.
set -euo pipefail
work=$(mktemp -d)
cd "$work"
trap 'rm -rf "$work"' EXIT
install() { "$work/$1/bin/python" -m pip install -qq --disable-pip-version-check numpy==2.4.6 gymnasium==1.4.0 imageio==2.38.1 packaging==26.3 "${@:2}"; }
cat > "$work/try.py" <<'PYTHON'
import sys
from importlib.metadata import version

import gymnasium

try:
    gymnasium.make("Hopper-v5")
    seen = "works"
except gymnasium.error.DependencyNotInstalled as error:
    seen = f"{error} (from {type(error.__cause__).__name__})"
names = ("mujoco", "mujoco-core", "gymnasium")
print(", ".join(f"{name} {version(name)}" for name in names))
print(f"  {sys.argv[1]}: expected works, seen {seen}")
if (seen == "works") == (sys.argv[1] == "upgraded"):
    sys.exit("stale: it is not as described")
PYTHON
for way in fresh upgraded; do
    python3 -m venv "$work/$way"
    if test "$way" = upgraded; then install "$way" mujoco==3.17.0; fi
    install "$way" mujoco==4.0.0
    "$work/$way/bin/python" -m pip check
    "$work/$way/bin/python" -W ignore "$work/try.py" "$way"
done
