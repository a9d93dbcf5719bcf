"""Environments of this package by gymnasium's ids; importing this module registers them.

`gymnasium.make("odaf.environments.gymnasium_ids:odaf/AntMaze-UMaze-v0")` does both in one. Where odaf itself takes an
id, as `odaf evaluate --env odaf/AntMaze-UMaze-v0`, nothing needs to be imported first.
"""

import gymnasium

from odaf.environments.ant_maze_map import EVALUATED

_LIMITS = {"umaze": 700}
_ANT_MAZES = {
    **{identity: ({"maze": name}, _LIMITS.get(name, 1000)) for identity, name in EVALUATED.items()},
    "odaf/AntMaze-v0": ({}, 1000),  # for maps of one's own
}

for _identity, (_kwargs, _limit) in _ANT_MAZES.items():
    gymnasium.register(
        _identity, entry_point="odaf.environments.ant_maze:AntMaze", kwargs=_kwargs, max_episode_steps=_limit
    )
