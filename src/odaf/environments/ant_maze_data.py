"""Ant-maze data recorded on the spot: the names of D4RL's sets, walks of our own walker.

An ant is led to a goal that is drawn for each walk and stays there until its time is up. All walks are told as attempts
at one goal, that of evaluation: the one that comes within 0.5 m of it earns 1 and ends, as an episode of evaluation
does, and the ant begins anew. docs/reference/generated-data.md says how the sets differ from D4RL's.
"""

from collections.abc import Iterable, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np

from odaf.data.dataset import Dataset
from odaf.environments.ant_maze import AntMaze
from odaf.environments.ant_maze_acceptance import acceptance_of, findings_of, statistics_of
from odaf.environments.ant_maze_map import ANT_MAZES
from odaf.environments.ant_maze_recorder import ACTION_NOISE, Walk, ants_for, record
from odaf.environments.ant_maze_sets import NAMES, SETS
from odaf.environments.contact_margins import ContactMargins
from odaf.environments.shipped_policies import Walker, shipped_walker
from odaf.errors import ConfigError
from odaf.training.progress import ProgressReport, Silent

MARGINS: ContactMargins = "larger"  # the body of the public data


def generate(
    name: str,
    transitions: int,
    seed: int = 0,
    progress: ProgressReport | None = None,
    walker: Walker | None = None,
    contact_margins: ContactMargins | None = None,
) -> Dataset:
    """Records the set called `name`; one seed gives the same bits on the same machine and versions.

    `infos` hold `qpos` and `qvel` (before the action, double precision), the `goal` of the walk, and `walk`, its
    number. `provenance` holds figures of the walks under "statistics", whether they are within limits under
    "acceptance", a finding for each that is not, and under "policies" what is known of the walker.

    Args:
        name: one of `NAMES`.
        transitions: rows, exactly; the last walk is cut to fit.
        seed: chooses starts, goals and actions.
        progress: hears how many rows are recorded.
        walker: who walks; None takes the shipped one.
        contact_margins: how the simulator counts them, see `odaf.environments.contact_margins`; None is "larger".

    Raises:
        ConfigError: the name is not known, or no walker is there.
    """
    if name not in SETS:
        raise ConfigError(f"data set '{name}' is not known; known are {', '.join(NAMES)}")
    if transitions < 1:
        raise ConfigError(f"transitions={transitions} must be at least 1")
    chosen, rule = SETS[name], contact_margins or MARGINS
    walker, progress = walker or shipped_walker(), progress or Silent()
    ants = [
        AntMaze(chosen.maze, "collection", chosen.random_start, rule)
        for _ in range(ants_for(transitions, chosen.steps))
    ]
    progress.start(name, transitions, unit="rows")
    rng = np.random.default_rng(seed)
    walks = record(ants, walker.policy, transitions, chosen.steps, rng, progress.advance, end=chosen.goal)
    progress.close()
    columns = columns_of(walks, transitions)
    statistics = statistics_of(walks, columns, ANT_MAZES[chosen.maze])
    acceptance = acceptance_of(statistics)
    return Dataset.from_arrays(
        **{key: columns[key] for key in ("observations", "actions", "rewards", "next_observations")},
        terminated=columns["terminated"],
        truncated=columns["truncated"],
        action_bounds=(-1.0, 1.0),
        infos={key: columns[key] for key in ("qpos", "qvel", "goal", "walk")},
        provenance={
            "name": name,
            "origin": "locally generated data",
            "environment": {
                "name": "gymnasium",
                "id": chosen.environment,
                "kwargs": {},
                "contact_margins": rule,
            },
            "generator": "odaf.environments.ant_maze_data",
            "seed": seed,
            "goal": list(chosen.goal),
            "action_noise": ACTION_NOISE,
            "policies": walker.facts,
            "versions": {
                **{package: version(package) for package in ("gymnasium", "mujoco", "numpy")},
                "contact_margins": rule,
            },
            "statistics": statistics,
            "acceptance": acceptance,
            "findings": findings_of(acceptance),
        },
        source=name,
    )


def columns_of(walks: Sequence[Walk], transitions: int) -> dict[str, Any]:
    """Walks as their first `transitions` rows, with the names of `Dataset` and of its infos.

    The last row of a walk that arrived earns 1 and ends the task. Any other last row of a walk, and the last row of
    all, is cut.
    """

    def joined(pieces: Iterable[np.ndarray]) -> np.ndarray:
        return np.concatenate(list(pieces))[:transitions]

    bodies, after = joined(walk.bodies[:-1] for walk in walks), joined(walk.bodies[1:] for walk in walks)
    lengths = [walk.length for walk in walks]
    ends = np.cumsum(lengths) - 1
    last, arrived = np.zeros(ends[-1] + 1, bool), np.zeros(ends[-1] + 1, bool)
    last[ends], arrived[ends] = True, [walk.arrived for walk in walks]
    last, arrived = last[:transitions], arrived[:transitions]
    last[-1] = True
    return {
        "observations": bodies.astype(np.float32),
        "actions": joined(walk.actions for walk in walks),
        "rewards": arrived.astype(np.float32),
        "next_observations": after.astype(np.float32),
        "terminated": arrived,
        "truncated": last & ~arrived,
        "qpos": bodies[:, :15],
        "qvel": bodies[:, 15:],
        "goal": np.repeat([walk.goal for walk in walks], lengths, axis=0)[:transitions],
        "walk": np.repeat(np.arange(len(walks)), lengths)[:transitions],
    }
