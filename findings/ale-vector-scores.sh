#!/bin/bash
# ALE/Qbert-v5 made by gymnasium.make pays 25 for a cube, the same id made by make_vec pays 1.
#
# Expected: `make_vec(id, num_envs=8)` is eight of what `make(id)` is; other defaults, if any, concern speed.
# Seen: ale-py brings a form of its own for `make_vec`, which gymnasium prefers wherever there is one. It cuts rewards to [-1, 1], starts
# with up to 30 steps of doing nothing and with the fire button, and stacks four grey pictures of 84 x 84. The id, the registered
# arguments and their repeated actions of 0.25 are the same. `RecordEpisodeStatistics` around it sums the cut rewards.
#
# Why it matters: the score of an episode, and the rewards of a log recorded so, count events instead of points, and scores that are scaled
# by the tables of random and human play become tiny. The pictures give their shape away, the rewards do not: in Pong, the
# usual first try, both forms pay the same. With `reward_clipping=False` the points come back.
#
# odaf makes every environment with `gymnasium.make` and takes no pictures.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check ale-py==0.12.1 gymnasium==1.3.0 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import ale_py
import gymnasium
import numpy as np
from gymnasium.wrappers import RecordEpisodeStatistics
from gymnasium.wrappers.vector import RecordEpisodeStatistics as RecordVectors

ale_py.ALEInterface.setLoggerMode(ale_py.LoggerMode.Error)
gymnasium.register_envs(ale_py)
repeat = "repeat_action_probability"


def play(environment):
    """What is paid in an episode of random actions, and the score that is recorded."""
    environment.action_space.seed(0)
    environment.reset(seed=0)
    paid, over = set(), False
    while not over:
        _, reward, terminated, truncated, info = environment.step(environment.action_space.sample())
        paid.add(float(np.squeeze(reward)))
        over = bool(np.squeeze(terminated)) or bool(np.squeeze(truncated))
    return sorted(paid), float(np.squeeze(info["episode"]["r"]))


print(f"ale-py {ale_py.__version__}, gymnasium {gymnasium.__version__}, numpy {np.__version__}; ALE/Qbert-v5, random actions")
single = gymnasium.make("ALE/Qbert-v5")
vector = gymnasium.make_vec("ALE/Qbert-v5", num_envs=1)
whole = gymnasium.make_vec("ALE/Qbert-v5", num_envs=1, reward_clipping=False)
print(f"  registered {repeat}: {single.spec.kwargs[repeat]} and {vector.spec.kwargs[repeat]}")
forms = {
    "make": RecordEpisodeStatistics(single),
    "make_vec": RecordVectors(vector),
    "make_vec, reward_clipping=False": RecordVectors(whole),
}
seen = {}
for name, environment in forms.items():
    seen[name], score = play(environment)
    print(f"  {name:31} expected rewards of 0 and 25 or more  seen {seen[name]}, score {score:.0f}")
if max(seen["make_vec"]) != 1.0 or any(max(rewards) < 25 for name, rewards in seen.items() if name != "make_vec"):
    sys.exit("stale: the rewards are not as described")
PYTHON
