"""Who is compared in the mazes: methods, their budgets, and the settings that are tried for each rival.

Every rival is tried with `TRIES` settings, its preset among them, on a log that no table is made of.
"""

from collections.abc import Mapping
from typing import Any

from odaf.studies.logs import MazeLog
from odaf.studies.task import Evaluation, Task
from odaf.studies.training import Training

Changes = tuple[tuple[str, Any], ...]
Winners = Mapping[str, Changes]
"""For rivals whose settings have been tried, the changes to the preset that did best."""

MAZES = ("stitch", "shaft", "crossroads", "ladder")
LOG_SEED = 2  # of the logs of the tables; no setting was tried on one of them
STEPS, EPISODES = 20_000, 50
EVALUATION = Evaluation(every=5_000, episodes=EPISODES)
PATHS = 10  # episodes whose paths a record keeps

BASE, OURS, THREE_STEPS = "odaf-without-outcome", "odaf", (("return_steps", 3),)
MBRCSL = "mbrcsl-pointmaze"

# Cheap ones first.
CHEAP = (
    *("behaviour-cloning", "behaviour-cloning-best", "td3-bc", "iql", "rebrac-return", "rebrac", "svr", "spot", "scas"),
)
COSTLY = ("mopo", "cql", "combo", "osr", "bear", "sdc", "osr-10")
OWN: tuple[tuple[str, Changes], ...] = ((BASE, ()), (OURS, ()), (BASE, THREE_STEPS), (OURS, THREE_STEPS))
PAPER = "odaf-paper"

STEPS_OF = {MBRCSL: 7_000, "bear": 25_000}
"""Updates of those that do not make `STEPS`: MBRCSL's policy learns for the hundred epochs that its paper gives it,
after its models; BEAR's actor sees no value in its first 5,000, which come on top."""
_FORM: dict[str, Changes] = {MBRCSL: (("rollout_steps", None),), "bear": (("warm_up_steps", 5_000),)}


def _each(field: str, *values: Any) -> tuple[Changes, ...]:
    return ((), *(((field, value),) for value in values))


def _both(first: str, second: str, *values: tuple[Any, Any]) -> tuple[Changes, ...]:
    return ((), *(((first, one), (second, other)) for one, other in values))


TRIES = 6
TRIED: dict[str, tuple[Changes, ...]] = {
    "behaviour-cloning": (*_each("learning_rate", 1e-4, 1e-3), *_each("batch_size", 64, 1024)[1:],
                          (("actor_kind", "gaussian"),)),
    "behaviour-cloning-best": _each("best_share", 0.02, 0.05, 0.2, 0.3, 0.5),
    "td3-bc": _each("value_weight", 1.0, 5.0, 10.0, 20.0, 40.0),
    "iql": _both("expectile", "inverse_temperature", (0.7, 10.0), (0.8, 3.0), (0.9, 3.0), (0.9, 10.0), (0.95, 10.0)),
    "rebrac-return": _both("actor_penalty", "critic_penalty", (0.01, 0.01), (0.05, 0.01), (0.1, 0.01), (0.1, 0.1),
                           (1.0, 0.1)),
    "rebrac": _both("actor_penalty", "critic_penalty", (0.001, 0.001), (0.05, 0.01), (0.1, 0.01), (0.1, 0.1),
                     (0.4, 0.1)),
    "svr": _each("support_weight", 1e-4, 3e-4, 3e-3, 1e-2, 5e-2),
    "spot": _each("support_weight", 0.05, 0.2, 0.5, 1.0, 2.0),
    "scas": (*_each("correction", 0.1, 0.5, 1.0), (("state_noise", 1e-2),), (("inverse_temperature", 1.0),)),
    "mopo": _both("horizon", "penalty", (1, 0.5), (1, 5.0), (5, 0.5), (5, 2.5), (5, 5.0)),
    "cql": _both("conservative_weight", "actor_learning_rate", (0.5, 1e-4), (1.0, 1e-4), (5.0, 1e-4), (1.0, 3e-4),
                 (5.0, 3e-4)),
    "combo": _both("horizon", "conservative_weight", (5, 0.5), (5, 5.0), (1, 1.0), (10, 0.5), (10, 1.0)),
    "osr": (*_each("conservative.weight", 1.0, 10.0), *_each("inverse_dynamics.weight", 0.1, 2.0)[1:],
            (("inverse_dynamics.state_noise", 1e-2),)),
    "bear": (*_each("threshold", 0.1, 0.2), *_both("kernel", "kernel_width", ("laplacian", 20.0), ("laplacian", 10.0),
             ("gaussian", 10.0))[1:]),
    "sdc": (*_each("conservative.weight", 1.0, 10.0), *_each("state_deviation.threshold", 0.1, 0.2)[1:],
            (("state_deviation.state_noise", 1e-2),)),
    "osr-10": (*_each("inverse_dynamics.weight", 0.1, 1.0, 2.0),
               *_each("inverse_dynamics.state_noise", 1e-3, 3e-2)[1:]),
    MBRCSL: (*_each("weight_decay", 1e-3, 1e-2), (("within_log", True),), (("normalise_returns", True),),
             (("within_log", True), ("weight_decay", 1e-3))),
}  # fmt: skip
"""By rival, the changes to its preset that are tried; the first is none."""


def maze_task(maze: str, seed: int = LOG_SEED, broad: bool = False, percent: int = 100) -> Task:
    """Finding the good path of a maze from the log of drivers who never took it.

    Args:
        maze: one of `MAZES`.
        seed: of the log.
        broad: whether several drivers took turns.
        percent: of the log.
    """
    return Task(MazeLog(maze, seed, episodes=EPISODES, broad=broad, percent=percent), EVALUATION, field="maze")


def training(preset: str, changes: Changes, task: Task, seed: int) -> Training:
    """A method on a log, for its number of updates; the record says in which maze."""
    log = task.log
    assert isinstance(log, MazeLog)
    notes = (("map", log.maze), ("log_seed", log.seed), ("broad", log.broad), ("percent", log.percent))
    steps = STEPS_OF.get(preset, STEPS)
    return Training(preset, task, seed, steps, changes, _FORM.get(preset, ()), notes=notes, paths=PATHS)
