"""Who competes for the default and on which logs: candidates, rivals, tuning logs and verdict logs.

Nothing is chosen on what it is judged by: candidates are tried on logs of seeds 0 and 1, the choice among them is made
from those records alone (`odaf.studies.default_scores.choice`), and the verdict's logs have another seed, as do its
trainings.
"""

from odaf.studies.logs import MazeLog, MixedLog, RecordedLog
from odaf.studies.robots import ROBOTS, ROWS, Changes, Method
from odaf.studies.task import Evaluation, Task
from odaf.studies.training import Training

TUNING_SEEDS = (0, 1)
"""Of the tuning logs; each with the same seed of the training."""
VERDICT_LOG_SEED = 4
"""Seeds 0 to 2 made logs that settings were tried or tables drawn on, 3 those of the study of choosing."""
VERDICT_SEEDS, MORE_SEEDS = (10, 11), (12, 13)
ABLATION_SEEDS = tuple(range(10, 18))
TUNING_STEPS, STEPS = 20_000, 50_000
TUNING_EVALUATION, EVALUATION = Evaluation(every=2_500, episodes=20), Evaluation(every=5_000, episodes=20)

AVERAGED: Changes = (("averaged_updates", 5_000),)
BY_LOG: Changes = (("return_temperature", "auto"),)
STEADY: Changes = (("sampling", "return"), *BY_LOG, ("warm_start_rows", "drawn"), *AVERAGED)
FADING: Changes = (("behaviour.weight", 0.4), ("behaviour.final_weight", 0.05), ("behaviour.decay_updates", 15_000))

ADVANTAGES: Changes = (("critic_sampling", "uniform"), ("advantage_after", 10_000))

# Cheap ones first.
CANDIDATES: tuple[Method, ...] = (
    ("odaf-anchored", ()),
    ("odaf-light", ()),
    ("rebrac-return", AVERAGED),
    ("rebrac-return", (*BY_LOG, *AVERAGED)),
    ("odaf-light", (("sampling", "uniform"),)),
    ("odaf-light", (("return_temperature", 0.1),)),
    ("odaf-light", FADING),
    ("odaf-light", ADVANTAGES),
    ("odaf-light", (("outcome.target_weight", 1.0),)),
    ("odaf-light-without-outcome", ()),
    ("odaf-anchored-without-outcome", ()),
    ("odaf-locomotion", STEADY),
    ("odaf-locomotion", AVERAGED),
)
DEFAULT: Method = ("odaf-light", ())
"""The candidate that is the default. Until all tuning records are there it is the one that was expected to win; then it
is the choice of `default_scores.choice`, which a test asserts."""

# Cheap ones first.
RIVALS: tuple[Method, ...] = (
    ("behaviour-cloning", ()),
    ("behaviour-cloning-best", ()),
    ("td3-bc", ()),
    ("iql", ()),
    ("rebrac-return", ()),
    ("odaf-locomotion", ()),
    ("rebrac", ()),
)
SLOW: tuple[Method, ...] = (("odaf-locomotion", ()), ("rebrac", ()))
"""Half an hour a run: ten critics; batches of 1,024 through three layers."""

PARTS: tuple[tuple[str, object], ...] = (
    ("outcome.weight", 0.0),
    ("outcome.target_weight", 0.0),
    ("advantage_after", 0),
    ("behaviour.weight", 0.0),
    ("ood.weight", 0.0),
    ("averaged_updates", 0),
    ("sampling", "uniform"),
    ("return_temperature", 0.1),
    ("warm_start_rows", "all"),
    ("return_steps", 1),
    ("num_critics", 10),
    ("actor_penalty", 0.0),
    ("critic_penalty", 0.0),
)
"""What a default may be made of, and the value that takes it out."""


def robot_log(robot: str, kind: str, seed: int) -> MixedLog | RecordedLog:
    """A log of 100,000 rows whose name says its seed.

    Args:
        robot: one of `ROBOTS`.
        kind: as in `medium-replay`, or `mixture-90` for 90 % random rows.
        seed: of starts and actions.
    """
    if kind.startswith("mixture-"):
        return MixedLog(robot, int(kind.removeprefix("mixture-")), ROWS, seed, seeded=True)
    return RecordedLog(f"{robot}-{kind}", ROWS, seed, seeded=True)


def robot_task(robot: str, kind: str, seed: int, evaluation: Evaluation = EVALUATION) -> Task:
    """A robot to be steered, learned from such a log."""
    return Task(robot_log(robot, kind, seed), evaluation, score="normalised_score")


def maze_task(maze: str, seed: int, evaluation: Evaluation = EVALUATION) -> Task:
    """Finding the good path of a maze from drivers who never took it."""
    return Task(MazeLog(maze, seed), evaluation)


def tuning_tasks(seed: int) -> list[Task]:
    """The four logs that candidates are tried on."""
    return [
        robot_task("hopper", "mixture-80", seed, TUNING_EVALUATION),
        robot_task("hopper", "medium", seed, TUNING_EVALUATION),
        maze_task("stitch", seed, TUNING_EVALUATION),
        robot_task("walker2d", "medium-replay", seed, TUNING_EVALUATION),
    ]


def first_verdict_tasks() -> list[Task]:
    """What two cores can do: the logs of Hopper, and one of each other robot."""
    kinds = ("mixture-80", "medium", "medium-replay", "mixture-90", "mixture-50")
    hopper = [robot_task("hopper", kind, VERDICT_LOG_SEED) for kind in kinds]
    others = [robot_task("halfcheetah", "medium", VERDICT_LOG_SEED)]
    return [*hopper, *others, robot_task("walker2d", "mixture-90", VERDICT_LOG_SEED)]


def other_verdict_tasks() -> list[Task]:
    """The two mazes, and the other robots' remaining logs."""
    kinds = ("mixture-80", "medium", "medium-replay")
    robots = [
        robot_task(robot, kind, VERDICT_LOG_SEED)
        for kind in kinds
        for robot in ROBOTS[1:]
        if (robot, kind) != ("halfcheetah", "medium")
    ]
    return [maze_task("shaft", VERDICT_LOG_SEED), maze_task("crossroads", VERDICT_LOG_SEED), *robots]


def ablation_tasks() -> list[Task]:
    """Three of the verdict's logs: mostly random, one mediocre controller, a replay buffer."""
    some = (("hopper", "mixture-80"), ("hopper", "medium"), ("walker2d", "medium-replay"))
    return [robot_task(robot, kind, VERDICT_LOG_SEED) for robot, kind in some]


def training(method: Method, task: Task, seed: int, steps: int = STEPS) -> Training:
    """A method on a log; the record says of which seed that is, and what a log of any seed is called."""
    preset, changes = method
    assert isinstance(task.log, MazeLog | MixedLog | RecordedLog)
    notes = (("log", task.log.known_as), ("log_seed", task.log.seed))
    return Training(preset, task, seed, steps, changes, notes=notes)


def name_of(method: Method) -> str:
    """What records and tables call a method."""
    return training(method, robot_task("hopper", "medium", VERDICT_LOG_SEED), 0).method


def without(part: str, value: object, method: Method = DEFAULT) -> Method | None:
    """A method without one of its parts; None where it does not have it."""
    from odaf.runs import presets

    preset, changes = method
    fields = presets.settings(preset)
    held = {name: field for name, field in fields.items() if name != "terms"}
    for term in fields.get("terms", []):
        held |= presets.dotted(term, f"{term['name']}.")
    held |= dict(changes)
    if part not in held or held[part] == value:
        return None
    if part == "return_temperature" and held.get("sampling") != "return":
        return None
    return preset, tuple({**dict(changes), part: value}.items())


def ablations(method: Method = DEFAULT) -> list[Method]:
    """The method, then the method without each of its parts."""
    return [method, *(found for part, value in PARTS if (found := without(part, value, method)) is not None)]
