"""Environments of this package by gymnasium's ids; importing this module registers them.

`gymnasium.make("odaf.environments.gymnasium_ids:odaf/AntMaze-UMaze-v0")` does both in one. Where odaf itself takes an
id, as `odaf evaluate --env odaf/AntMaze-UMaze-v0`, nothing needs to be imported first.
"""

import gymnasium

_ANT_MAZES = {
    "odaf/AntMaze-UMaze-v0": ({"maze": "umaze"}, 700),
    "odaf/AntMaze-Medium-v0": ({"maze": "medium"}, 1000),
    "odaf/AntMaze-Large-v0": ({"maze": "large"}, 1000),
    "odaf/AntMaze-v0": ({}, 1000),  # for maps of one's own
}

for _identity, (_kwargs, _limit) in _ANT_MAZES.items():
    gymnasium.register(
        _identity, entry_point="odaf.environments.ant_maze:AntMaze", kwargs=_kwargs, max_episode_steps=_limit
    )
