#!/bin/bash
# brax starts every episode of a parallel environment at the place where its first one started.
#
# Expected: an environment that begins anew by itself draws a new start, as gymnasium's vectors do; a hundred episodes of each of four
# parallel environments have four hundred starts.
# Seen: four. `envs.create` and `training.wrap`, which training and evaluation go through, put an auto-reset around the environment
# that keeps the first observation and state and puts them back at each end. The key of `reset` is used once.
#
# Why it matters: a log of a million steps from 16 parallel environments knows 16 starts, however long it is, and a policy learnt from it
# has never seen another. An evaluation of ten episodes an environment has as many independent starts as environments, so its
# standard error is too small. Shuffled, the log shows nothing.
#
# odaf records and evaluates through gymnasium, one environment at a time, and resets each episode with a seed of its own.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install -qq --disable-pip-version-check brax==0.14.2 jax==0.10.2 jaxlib==0.10.2 numpy==2.4.6
JAX_PLATFORMS=cpu "$work/venv/bin/python" -W ignore - 2> /dev/null <<'PYTHON' || { echo "stale, or it could not run"; exit 1; }
import sys
from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
from brax.envs.base import Env, State
from brax.envs.wrappers import training


class Walk(Env):
    """A point that starts anywhere in [0, 1] and moves by its action."""

    observation_size = action_size = 1
    backend = "none"

    def reset(self, rng):
        place = jax.random.uniform(rng, (1,))
        return State(place, place, jnp.zeros(()), jnp.zeros(()), {}, {})

    def step(self, state, action):
        place = state.pipeline_state + action
        return state.replace(pipeline_state=place, obs=place, reward=jnp.ones(()), done=jnp.zeros(()))


parallel, length, episodes = 4, 5, 100
environment = training.wrap(Walk(), episode_length=length)
state = jax.jit(environment.reset)(jax.random.split(jax.random.PRNGKey(0), parallel))
step = jax.jit(environment.step)
starts = [np.ravel(state.obs)]
for _ in range(length * (episodes - 1)):
    state = step(state, jnp.full((parallel, 1), 0.01))
    if np.any(state.done):
        starts.append(np.ravel(state.obs))
different = len(np.unique(starts))
print(f"brax {version('brax')}, jax {version('jax')}, numpy {np.__version__}")
print(f"{len(starts)} episodes of each of {parallel} parallel environments: different starts expected {np.size(starts)}, seen {different}")
for number in (0, 1, len(starts) - 1):
    print(f"  episode {number:3} starts at {starts[number]}")
sys.exit(not (len(starts) == episodes and different == parallel))
PYTHON
