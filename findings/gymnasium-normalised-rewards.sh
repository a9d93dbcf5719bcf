#!/bin/bash
# gymnasium's NormalizeReward carries the return of one episode into the next.
#
# Expected: rewards are divided by the spread of the running discounted return; an episode's end, by its own doing or by the time limit,
# begins that return anew, and its last reward counts for the episode that it ends.
# Seen: a time limit does not begin it anew, nor does `reset`: with a discount of one, tasks that only a time limit ends have one return
# that grows for as long as the wrapper lives, and rewards shrink towards nothing. Where an episode ends by its own doing the return is
# emptied before the last reward is added: that reward stands alone, and the next episode begins with it.
#
# Why it matters: a constant reward of one is handed out as 0.45 in the second episode and as 0.014 in the fiftieth. A log recorded
# behind the wrapper holds rewards that depend on how long it had been running; where the goal pays once, at the end, the pay is
# taken for a part of the episode after it.
#
# odaf records an environment's own rewards, and scales them, where a setting says so (`reward_scale`), by one number for the whole log.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check gymnasium==1.4.0 numpy==2.4.6
"$work/venv/bin/python" -W ignore - <<'PYTHON'
import sys

import gymnasium
import numpy as np
from gymnasium.wrappers import NormalizeReward


class Steps(gymnasium.Env):
    """Five steps of reward one, ended by the task itself or by a limit of time."""

    observation_space = gymnasium.spaces.Box(0, 5, (1,), np.float32)
    action_space = gymnasium.spaces.Discrete(2)

    def __init__(self, limit):
        self.limit, self.steps = limit, 0

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.steps += 1
        over = self.steps == 5
        return np.full(1, self.steps, np.float32), 1.0, over and not self.limit, over and self.limit, {}


def play(limit, episodes=100):
    environment = NormalizeReward(Steps(limit), gamma=1.0)
    returns, rewards = [], []
    for _ in range(episodes):
        environment.reset(seed=0)
        for _ in range(5):
            rewards.append(float(environment.step(0)[1]))
            returns.append(float(np.squeeze(environment.discounted_reward)))
    return np.reshape(returns, (-1, 5)), np.reshape(rewards, (-1, 5))


print(f"gymnasium {gymnasium.__version__}, numpy {np.__version__}; running return of rewards of one, no discount, five steps an episode")
print("  expected in every episode: [1. 2. 3. 4. 5.]")
own, _ = play(limit=False)
timed, rewards = play(limit=True)
print(f"  ended by the task, seen in the second episode: {own[1]}")
print(f"  ended by a limit,  seen in the second episode: {timed[1]}, in the last: {timed[-1]}")
second, fiftieth, last = (rewards[number].mean() for number in (1, 49, -1))
print(f"  the reward handed out, second episode: {second:.3f}; fiftieth: {fiftieth:.3f}; last: {last:.3f}")
if own[1].tolist() != [2, 3, 4, 5, 1] or timed[-1].tolist() != [496, 497, 498, 499, 500]:
    sys.exit("stale: the returns are not as described")
PYTHON
