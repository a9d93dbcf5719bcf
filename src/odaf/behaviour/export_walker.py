"""From a run of the ant to the walker that the package ships: which snapshot, in half precision, and how it walks.

All snapshots walk once in each of sixteen directions. Those that reach most waypoints, the fastest among equals, get a
close look: ten walks in each direction, and walks through the largest maze, where ants must turn and meet walls. The
one that reaches most goals there is taken, of equals the one that turns over less often.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from odaf.behaviour.ant_task import AntTask, walk
from odaf.behaviour.exported import halved_snapshots, package_versions, training_record
from odaf.behaviour.online import OnlineRun, curve_in, run_in
from odaf.environments.ant_maze import AntMaze
from odaf.environments.ant_maze_acceptance import flipped, steps_to_goal
from odaf.environments.ant_maze_recorder import record
from odaf.environments.ant_walker import AntWalker
from odaf.environments.gaussian_policy import GaussianPolicy
from odaf.environments.shipped_policies import WALKER, pack_policies
from odaf.training.files import write_arrays, write_json
from odaf.training.progress import ProgressReport, Silent

DIRECTIONS = 16
CANDIDATES = 6  # snapshots that get a close look
WALKS = 10  # in each direction
MAZE, MAZE_WALKS, MAZE_STEPS = "large-play", 50, 1000
SEED = 7


@dataclass(frozen=True)
class Look:
    """A snapshot and how it walks with noise on its actions, as where data are recorded.

    Attributes:
        step: of the snapshot.
        walks: in each direction.
        success: share of walks that reached a waypoint 8 m away within 150 steps, for each direction, from that of x on
            towards y.
        mean_speed: metres a second on the way.
        flipped: share of walks in which the ant turned over.
        maze: name of the map of the other walks.
        maze_walks: how many.
        maze_reached: share of them that reached their goal.
        maze_flipped: share of them that ended on their back.
    """

    step: int
    walks: int
    success: tuple[float, ...]
    mean_speed: float
    flipped: float
    maze: str
    maze_walks: int
    maze_reached: float
    maze_flipped: float


def export_walker(
    directory: Path, policies: Path, ledger: Path, progress: ProgressReport | None = None
) -> dict[str, Any]:
    """Chooses a snapshot of a run of the ant and writes it.

    Args:
        directory: a run directory of `train`; it may still be going on.
        policies: folder for `ant.npz` and `ant.json`, the package's own to ship them.
        ledger: folder for `ant-seedSEED.json`, the run's settings and learning curve.
        progress: hears how many snapshots were looked at.

    Returns:
        The page of facts; "walker" holds the `Look` at the chosen one.

    Raises:
        ConfigError: there is no run, or it has no snapshots yet.
    """
    run, curve = run_in(directory), curve_in(directory)
    loaded = halved_snapshots(directory, run)
    progress = progress or Silent()
    ants = run.bodies(DIRECTIONS)
    progress.start("walkers", len(loaded), unit="snapshots")
    looks: dict[int, tuple[float, float]] = {}
    for step, policy in loaded.items():
        walked = walk(policy, ants, SEED)
        looks[step] = float(walked.reached.mean()), float(walked.speeds.mean())
        progress.advance(len(looks), f"waypoints {looks[step][0]:.0%}, {looks[step][1]:.2f} m/s")
    best = sorted(looks, key=lambda step: looks[step], reverse=True)[:CANDIDATES]
    progress.start("the best walkers", len(best), unit="snapshots")
    close = []
    for step in best:
        close.append(_look(step, loaded[step], ants, run))
        progress.advance(len(close), f"goals {close[-1].maze_reached:.0%}")
    progress.close()
    taken = max(close, key=lambda look: (look.maze_reached, -look.maze_flipped, look.step))
    training = training_record(run, max([*loaded, *(line["step"] for line in curve)]))
    facts = {"task": run.task, "environment": AntTask.environment, "training": training}
    facts |= {"steps": [taken.step], "walker": {"index": 0, **asdict(taken)}}
    policies.mkdir(parents=True, exist_ok=True)
    write_arrays(policies / f"{WALKER}.npz", pack_policies([loaded[taken.step]]))
    write_json(policies / f"{WALKER}.json", facts)
    ledger.mkdir(parents=True, exist_ok=True)
    write_json(ledger / f"{WALKER}-seed{run.seed}.json", _ledger(run, training, curve, looks, close, taken))
    return facts


def _look(step: int, policy: GaussianPolicy, ants: Sequence[AntWalker], run: OnlineRun) -> Look:
    walked = [walk(policy, list(ants), SEED + 1 + index) for index in range(WALKS)]
    mazes = [AntMaze(MAZE, "collection", True, run.contact_margins or "larger") for _ in range(MAZE_WALKS)]
    walks = record(mazes, policy, MAZE_WALKS * MAZE_STEPS, MAZE_STEPS, np.random.default_rng(SEED))
    return Look(
        step,
        WALKS,
        tuple(np.mean([each.reached for each in walked], axis=0).tolist()),
        float(np.mean([each.speeds for each in walked])),
        float(np.mean([each.flipped for each in walked])),
        MAZE,
        MAZE_WALKS,
        float(np.mean([steps_to_goal(walk) is not None for walk in walks])),
        float(np.mean([flipped(walk) for walk in walks])),
    )


def _ledger(
    run: OnlineRun,
    training: Mapping[str, Any],
    curve: list[dict[str, Any]],
    looks: Mapping[int, tuple[float, float]],
    close: Sequence[Look],
    taken: Look,
) -> dict[str, Any]:
    """What `results/` keeps of a run."""
    return {
        "study": "behaviour",
        "environment": AntTask.environment,
        "seed": run.seed,
        **training,
        "versions": package_versions(),
        "walker": asdict(taken),
        "curve": curve,
        "looks": [{"step": step, "success": share, "mean_speed": speed} for step, (share, speed) in looks.items()],
        "close_looks": [asdict(look) for look in close],
    }
