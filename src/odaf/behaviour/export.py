"""From a training run to the policies that the package ships: which snapshots, in half precision, and what they earn.

Levels are those of the published sets. A level is looked for among all snapshots with stochastic actions and a few
episodes each; the nearest ones are measured with more episodes and with their noise a little narrower or wider, since
the public policies' noise is not known. Of those that fall about as often as the published set's the nearest is taken,
and as trained where that is near enough; if none falls so often, the nearest of all.
"""

import itertools
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from odaf.behaviour.exported import halved_snapshots, package_versions, training_record
from odaf.behaviour.locomotion_task import play
from odaf.behaviour.online import OnlineRun, curve_in, run_in
from odaf.environments.gaussian_policy import GaussianPolicy
from odaf.environments.locomotion import Simulator, Task, task_of
from odaf.environments.locomotion_acceptance import PUBLISHED, PUBLISHED_SPREAD, SPREAD_FACTOR, terminal_limits
from odaf.environments.reference_returns import REFERENCES, Reference
from odaf.environments.shipped_policies import pack_policies, stacked_policies
from odaf.errors import ConfigError
from odaf.training.files import write_arrays, write_json
from odaf.training.progress import ProgressReport, Silent

FIRST_LOOK, CLOSE_LOOK = 5, 40  # episodes
CANDIDATES = 8  # snapshots of a level that get a close look
SPREADS = (1.0, 0.85, 0.7, 0.5, 1.15, 1.3, 1.5)
NEAR = 1.0  # points from the target at which noise stays as trained
ALIKE_WITHIN = 2.0  # points from the target up to which right falls and a right spread count more than a nearer score
EXPERT_MARGIN = 1.0  # points above the published set's mean that an expert is looked for at: rather better than worse
MEDIUM_WITHIN, EXPERT_WITHIN = 5.0, 3.0  # points from the target at which a level counts as reached
PHASES = 20  # snapshots that stand for the run up to the medium policy
SEED = 7


@dataclass(frozen=True)
class Level:
    """A snapshot and what it earns with stochastic actions."""

    step: int
    spread: float
    episodes: int
    mean_return: float
    std_return: float
    normalised_score: float
    fall_share: float


def export(
    directory: Path,
    policies: Path,
    ledger: Path,
    progress: ProgressReport | None = None,
    *,
    expert_only: bool = False,
) -> dict[str, Any]:
    """Choose levels and phases from a run and write them.

    Args:
        directory: a run directory of `train`; it may still be going on.
        policies: folder for `TASK.npz` and `TASK.json`, the package's own to ship them.
        ledger: folder for `TASK-seedSEED.json`, the run's settings and learning curve.
        progress: hears how many policies were looked at.
        expert_only: take the expert from this run and leave the medium and replay policies in `policies` as they are.

    Returns:
        The page of facts. "expert" says under "reached" whether it is as good as the published set's policy; a
        medium policy that is not is left out, an expert one is the best there was.

    Raises:
        ConfigError: there is no run, or it has no snapshots yet; or with `expert_only` nothing is there to add to.
    """
    run, curve = run_in(directory), curve_in(directory)
    task = task_of(run.task, run.version)
    reference = REFERENCES[task.family]
    loaded = halved_snapshots(directory, run)
    progress = progress or Silent()
    simulators = run.bodies(CLOSE_LOOK)
    progress.start(f"{task.name} snapshots", len(loaded), unit="snapshots")
    looks: dict[int, float] = {}
    for step, policy in loaded.items():
        returns = play(policy, simulators[:FIRST_LOOK], SEED, stochastic=True).returns
        looks[step] = reference.normalise(float(returns.mean()))
        progress.advance(len(looks), f"score {looks[step]:.1f}")
    progress.close()

    def search(level: str) -> Level:
        name = f"{task.name}-{level}"
        target, falls = PUBLISHED[name]
        target += EXPERT_MARGIN if level == "expert" else 0.0
        near = sorted(looks, key=lambda step: (abs(looks[step] - target), step))[:CANDIDATES]
        candidates = {step: loaded[step] for step in near}
        return _nearest(candidates, simulators, reference, target, terminal_limits(falls), _spreads(name))

    training = training_record(run, max([*loaded, *(line["step"] for line in curve)]))
    targets = {level: PUBLISHED[f"{task.name}-{level}"][0] for level in ("medium", "expert")}
    best = search("expert")
    reached = best.normalised_score >= targets["expert"] - EXPERT_WITHIN
    expert = {"reached": reached, **asdict(best), "training": training}
    if expert_only:
        facts, chosen = _kept(policies, task)
    else:
        facts, chosen = {"task": task.name, "environment": task.environment_id(run.version), "training": training}, []
        medium = search("medium")
        if abs(medium.normalised_score - targets["medium"]) <= MEDIUM_WITHIN:
            phases = _phases(run, list(loaded), medium.step)
            steps = sorted({step for _, step in phases if step is not None} | {medium.step})
            facts["steps"], chosen = steps, [loaded[step] for step in steps]
            index = {step: position for position, step in enumerate(steps)}
            facts["medium"] = {"index": index[medium.step], **asdict(medium)}
            facts["replay"] = [{"steps": length, "index": None if at is None else index[at]} for length, at in phases]
        else:
            facts |= {"steps": [], "medium": None, "replay": []}
    facts |= {"steps": [*facts["steps"][: len(chosen)], best.step], "expert": {"index": len(chosen), **expert}}
    policies.mkdir(parents=True, exist_ok=True)
    write_arrays(policies / f"{task.name}.npz", pack_policies([*chosen, loaded[best.step]]))
    write_json(policies / f"{task.name}.json", facts)
    ledger.mkdir(parents=True, exist_ok=True)
    write_json(
        ledger / f"{task.name}-seed{run.seed}.json", _ledger(run, task, facts, training, curve, looks, expert_only)
    )
    return facts


def _nearest(
    candidates: dict[int, GaussianPolicy],
    simulators: Sequence[Simulator],
    reference: Reference,
    target: float,
    falls: tuple[float, float],
    spreads: tuple[float, float],
) -> Level:
    """The candidate and spread whose mean score is nearest to the target, among those with a right share of falls and a
    right standard deviation of returns."""

    def distance(level: Level) -> float:
        return abs(level.normalised_score - target)

    def is_alike(level: Level) -> bool:
        return falls[0] <= level.fall_share <= falls[1] and spreads[0] <= level.std_return <= spreads[1]

    found: list[Level] = []
    for spread in SPREADS:
        for step, policy in candidates.items():
            played = play(replace(policy, spread=spread), simulators, SEED + 1, stochastic=True)
            mean, std = float(played.returns.mean()), float(played.returns.std())
            score = reference.normalise(mean)
            found.append(Level(step, spread, len(played.returns), mean, std, score, played.fall_share))
        alike = [level for level in found if is_alike(level)]
        if alike and distance(best := min(alike, key=distance)) <= NEAR:
            return best
    alike = [level for level in found if is_alike(level) and distance(level) <= ALIKE_WITHIN]
    return min(alike or found, key=distance)


def _spreads(name: str) -> tuple[float, float]:
    """Standard deviations of returns to look for. An expert may be steadier than the published one, not a medium
    policy: what it does not try cannot be learnt from it."""
    published = PUBLISHED_SPREAD[name]
    return published / SPREAD_FACTOR if name.endswith("-medium") else 0.0, SPREAD_FACTOR * published


def _phases(run: OnlineRun, snapshots: Sequence[int], end: int) -> list[tuple[int, int | None]]:
    """(length, snapshot) of consecutive stretches of the run: uniform actions first, then the snapshot nearest to the
    middle of each stretch."""
    count = max(1, min(PHASES, (end - run.random_steps) // run.snapshot_every))
    borders = np.linspace(run.random_steps, end, count + 1).round().astype(int).tolist()
    phases: list[tuple[int, int | None]] = [(run.random_steps, None)]
    for low, high in itertools.pairwise(borders):
        phases.append((high - low, min(snapshots, key=lambda step: abs(step - (low + high) / 2))))
    return phases


def _kept(policies: Path, task: Task) -> tuple[dict[str, Any], list[GaussianPolicy]]:
    """The facts that are there and the policies of medium and replay, which come before the expert."""
    try:
        facts = json.loads((policies / f"{task.name}.json").read_text(encoding="utf-8"))
        with np.load(policies / f"{task.name}.npz", allow_pickle=False) as content:
            layers = {name: content[name] for name in content.files}
    except FileNotFoundError as error:
        raise ConfigError(f"{error.filename}: nothing is there to add an expert to; export a whole run first") from None
    return facts, stacked_policies(layers)[: facts["expert"]["index"]]


def _ledger(
    run: OnlineRun,
    task: Task,
    facts: dict[str, Any],
    training: dict[str, Any],
    curve: list[dict[str, Any]],
    looks: dict[int, float],
    expert_only: bool,
) -> dict[str, Any]:
    """What `results/` keeps of a run."""
    return {
        "study": "behaviour",
        "environment": task.environment_id(run.version),
        "seed": run.seed,
        **training,
        "versions": package_versions(),
        "medium": None if expert_only else facts["medium"],
        "expert": {name: value for name, value in facts["expert"].items() if name != "training"},
        "curve": curve,
        "stochastic_scores": [{"step": step, "normalised_score": score} for step, score in looks.items()],
    }
