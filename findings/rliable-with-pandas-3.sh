#!/bin/bash
# `pip install rliable` gives an rliable that cannot be imported.
#
# Expected: what pip puts together without a complaint can be imported; an incompatible newer pandas would be excluded.
# Seen: rliable 1.2.0 asks for arch below 8, of which 7.2.0 is the newest, and neither says that pandas must be below 3. arch 7.2.0
# decorates a method with a helper out of pandas' own internals, which has another first argument from pandas 3 on, so that `import
# rliable.library` ends in a TypeError that names neither package. `pip check` is content. With pandas 2.3.3 it works; arch 8.0.0
# works with pandas 3 and is what rliable excludes.
#
# Why it matters: interquartile means with stratified bootstrap intervals are what offline RL is asked to report, and this is the
# package that papers name for them; an evaluation script fails at its first line, after the training.
#
# odaf computes these figures itself, with SciPy and NumPy, and the tests hold golden values of them.
set -euo pipefail
work=$(mktemp -d)
cd "$work"
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
install() { "$work/venv/bin/python" -m pip install -qq --disable-pip-version-check "$@"; }
cat > "$work/try.py" <<'PYTHON'
import sys
from importlib.metadata import version

try:
    import rliable.library
    seen = "works"
except TypeError as error:
    seen = f"TypeError: {error}"
print(", ".join(f"{name} {version(name)}" for name in ("rliable", "arch", "pandas")))
print(f"  import rliable.library: expected works, seen {seen}")
if (seen == "works") != (sys.argv[1] == "works"):
    sys.exit("stale: it is not as described")
PYTHON
common=(numpy==2.4.6 scipy==1.17.1 statsmodels==0.15.0 rliable==1.2.0)
install "${common[@]}" pandas==3.1.1
"$work/venv/bin/python" -m pip check
"$work/venv/bin/python" -W ignore "$work/try.py" fails
install "${common[@]}" pandas==2.3.3
"$work/venv/bin/python" -m pip check
"$work/venv/bin/python" -W ignore "$work/try.py" works
