"""The guard's study: how often it alarms in sound episodes, and what it sees and saves where a robot is put off.

A policy learns from a robot's medium log. Its guard is calibrated on other episodes of whoever wrote that log. The rate
of false alarms is then counted in fresh episodes of the same, for which it is promised, and in the policy's own, for
which it is not. Disturbed episodes are played three times from the same starts: unguarded, and with the cloned
behaviour as the reaction at each rate. A knock takes the controls away for some simulator steps; an attack moves all
that is seen from then on, in the direction that the critics like least. What happens in the steps after counts, in
which hardly an episode ends by itself: over whole episodes a mediocre policy falls anyhow. Beside them stand the same
steps of episodes that nothing disturbs.

    detected         share of disturbed episodes with an alarm after the disturbance, within the steps that count
    falls_avoided    (falls unguarded - falls guarded) / falls unguarded, in these steps, of all disturbances together;
                     below 0 where the guard does harm; None where nothing fell, or a body cannot fall
"""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from odaf.studies.job import Job, Phase, Record, Study, Work
from odaf.studies.logs import LOCAL, RecordedLog, policies_print
from odaf.studies.task import Evaluation, Task
from odaf.studies.training import Training

if TYPE_CHECKING:
    from odaf.data.dataset import Dataset
    from odaf.deployment import GuardedPolicy
    from odaf.evaluation.rollouts import Episodes
    from odaf.training.progress import ProgressReport

ROBOTS = ("hopper", "walker2d", "halfcheetah")
RATES = (0.01, 0.05)
LOG_SEED, CALIBRATION_SEED, FRESH_SEED = 11, 12, 13
FALLS = {"hopper", "walker2d"}
SIDE_BY_SIDE = 100  # episodes
NOTHING = "nothing"  # the name of no disturbance
VERSION = 2  # raised when the same settings would give other figures

Shown = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Guarding(Work):
    """One robot.

    Attributes:
        robot: as in `hopper`.
        preset: of the learner whose policy is guarded.
        steps: updates.
        rows: of the log that it learns from.
        calibration: episodes set aside.
        fresh: episodes in which false alarms are counted, of the behaviour and of the policy.
        counted: most steps of these.
        disturbed: episodes of each disturbance.
        at: step after which it comes.
        window: steps after it that count.
        knocks: simulator steps without control, of each knock.
        budgets: of each attack, in standard deviations.
        settings: of the guard, other than the defaults.
    """

    robot: str
    preset: str = "td3-bc"
    steps: int = 20_000
    rows: int = 100_000
    calibration: int = 200
    fresh: int = 500
    counted: int = 1_000
    disturbed: int = 100
    at: int = 100
    window: int = 200
    knocks: tuple[int, ...] = (15, 30, 45)
    budgets: tuple[float, ...] = (0.1, 0.3)
    settings: tuple[tuple[str, Any], ...] = ()

    @property
    def set_name(self) -> str:
        """Of the log."""
        return f"{self.robot}-medium"

    @property
    def labels(self) -> dict[str, tuple[str, ...]]:
        return {"robot": (self.robot,)}

    def guess(self) -> float:
        return 900.0

    def said(self, record: Record) -> str:
        found = [f"{rate}: {each['detected']:.0%} detected" for rate, each in record["rates"].items()]
        return ", ".join(found)

    def identity(self) -> dict[str, Any]:
        from odaf.training.files import plain

        own = {**asdict(self), "settings": dict(self.settings)}
        return plain({"version": VERSION, **own, "policies_sha256": policies_print(self.set_name)})

    def do(self, place: Path, progress: "ProgressReport") -> Record:
        from odaf.deployment import guards

        begun = time.monotonic()
        task = Task(RecordedLog(self.set_name, self.rows, LOG_SEED), Evaluation(self.steps, 10), "normalised_score")
        run = Training(self.preset, task, 0, self.steps).trained(place, progress)
        progress.start(f"guard of {self.robot}", 4)
        aside, fresh = (
            self.episodes_of(seed, count, place)
            for seed, count in ((CALIBRATION_SEED, self.calibration), (FRESH_SEED, self.fresh))
        )
        progress.advance(1)
        made = guards(run.directory, aside, RATES, reaction="clone", **dict(self.settings))
        progress.advance(2)
        behaviour = [_share(_alarms_in(each, fresh)) for each in made]
        own = self.own_alarms(made, fresh.environment or {})
        progress.advance(3)
        disturbances = self.disturbances(made, run.directory, fresh.environment or {})
        progress.close()
        rates = {}
        for index, rate in enumerate(RATES):
            by_kind = {kind: figures[index] for kind, figures in disturbances.items()}
            disturbed = [figures for kind, figures in by_kind.items() if kind != NOTHING]
            rates[str(rate)] = {
                "false_alarms": behaviour[index],
                "false_alarms_policy": own[index],
                "detected": float(np.mean([each["detected"] for each in disturbed])),
                "falls_avoided": _avoided(disturbed) if self.robot in FALLS else None,
                "by_disturbance": by_kind,
                "guard": made[index].to_dict(),
            }
        return {
            "robot": self.robot,
            "origin": LOCAL,
            "identity": self.identity(),
            "policy": run.summary[0]["evaluation"],
            "episodes": {"calibration": aside.num_episodes, "fresh": fresh.num_episodes, "own": self.fresh},
            "rates": rates,
            "seconds": time.monotonic() - begun,
        }

    def episodes_of(self, seed: int, count: int, place: Path) -> "Dataset":
        """So many whole episodes of whoever wrote the log, on seeds of their own."""
        from odaf.data.dataset import Dataset

        log = Dataset.load(RecordedLog(self.set_name, self.rows, LOG_SEED).present(place))
        rows = int(1.1 * count * len(log) / log.num_episodes) + 1_000
        while True:
            dataset = Dataset.load(RecordedLog(self.set_name, rows, seed).present(place))
            if dataset.num_episodes > count:  # the last one is cut
                return dataset.select(range(count))
            rows *= 2

    def own_alarms(self, made: "Sequence[GuardedPolicy]", environment: Mapping[str, Any]) -> list[float]:
        """For each guard the share of the policy's own episodes with an alarm."""
        from odaf.environments.knocks import Knock

        found = []
        for first in range(0, self.fresh, SIDE_BY_SIDE):
            count = min(SIDE_BY_SIDE, self.fresh - first)
            watched = _Watched(_only_warning(made))
            _play(watched, environment, Knock(0), count, self.counted, 100 + first // SIDE_BY_SIDE)
            found.append(watched.alarms().any(axis=0))
        return np.concatenate(found, axis=1).mean(axis=1).tolist()

    def disturbances(
        self, made: "Sequence[GuardedPolicy]", run: Path, environment: Mapping[str, Any]
    ) -> dict[str, list[dict[str, Any]]]:
        """By the disturbance, what is found for each guard."""
        import jax.random as jr

        from odaf.environments.knocks import Knock
        from odaf.evaluation.attacks import ATTACKS, AttackedPolicy, Judge
        from odaf.training.run_directory import RunDirectory

        policy, judge = made[0].policy, Judge.of(RunDirectory(run), 0)

        def played(guards: "Sequence[GuardedPolicy]", knock: int, budget: float) -> "tuple[Episodes, np.ndarray]":
            """The episodes, and [guards, episodes] which had an alarm once they were disturbed."""
            attack = AttackedPolicy(policy, ATTACKS["min-q"], budget, jr.key(0), judge=judge)
            watched = _Watched(guards, attack.shown if budget else None, self.at)
            blow = Knock(knock, self.at)
            episodes = _play(watched, environment, blow, self.disturbed, self.at + self.window, 1)
            return episodes, np.asarray(np.any(watched.alarms()[self.at :], axis=0))

        kinds = {NOTHING: (0, 0.0)}
        kinds |= {f"knock, {steps} steps": (steps, 0.0) for steps in self.knocks}
        kinds |= {f"attack, {budget:g}": (0, budget) for budget in self.budgets}
        found: dict[str, list[dict[str, Any]]] = {}
        for kind, (knock, budget) in kinds.items():
            alone, alarms = played(_only_warning(made), knock, budget)
            there = alone.lengths > self.at
            found[kind] = []
            for index, guarded in enumerate(made):
                saved, _ = played([guarded], knock, budget)
                found[kind].append(
                    {
                        "episodes": int(there.sum()),
                        "detected": _share(alarms[index][there]),
                        "falls": int((~alone.flags["survived"][there]).sum()),
                        "falls_guarded": int((~saved.flags["survived"][there]).sum()),
                    }
                )
        return found


class _Watched:
    """Plays the first of several guarded policies, and notes the alarms of all.

    Args:
        guards: of one policy.
        shown: what is seen in the place of the observations; None for these.
        since: step from which on that is so.
    """

    def __init__(self, guards: "Sequence[GuardedPolicy]", shown: Shown | None = None, since: int = 0):
        self._guards, self._shown, self._since, self._noted = guards, shown, since, list[np.ndarray]()

    def begin(self, rows: int) -> tuple[Any, ...]:
        return tuple(guard.begin(rows) for guard in self._guards)

    def act(self, carry: tuple[Any, ...], observations: np.ndarray) -> tuple[np.ndarray, tuple[Any, ...]]:
        deceived = self._shown is not None and len(self._noted) >= self._since
        seen = self._shown(observations) if deceived and self._shown is not None else observations
        taken = [guard.act(each, seen) for guard, each in zip(self._guards, carry, strict=True)]
        self._noted.append(np.stack([each.alarm for _, each in taken]))
        return taken[0][0], tuple(each for _, each in taken)

    def observe(self, carry: tuple[Any, ...], rewards: np.ndarray) -> tuple[Any, ...]:
        del rewards
        return carry

    def ended(self, lengths: np.ndarray) -> None:
        """Takes out what was noted after the end of an episode, whose last observation goes on being asked."""
        for step, noted in enumerate(self._noted):
            noted &= (step < lengths)[None]

    def alarms(self) -> np.ndarray:
        """[time, guards, episodes] bool."""
        return np.stack(self._noted)


def _play(
    watched: _Watched, environment: Mapping[str, Any], knock: Any, episodes: int, counted: int, seed: int
) -> "Episodes":
    from odaf.environments.knocks import Knocked
    from odaf.environments.registry import make_untimed
    from odaf.evaluation.rollouts import rollout

    build, _ = make_untimed(environment)
    found = rollout(watched, lambda: Knocked(build(), knock, counted), episodes, seed)
    watched.ended(found.lengths)
    return found


def _only_warning(made: "Sequence[GuardedPolicy]") -> "list[GuardedPolicy]":
    from dataclasses import replace

    return [replace(each, reaction="warn") for each in made]


def _alarms_in(guarded: "GuardedPolicy", dataset: "Dataset") -> np.ndarray:
    """[episodes] bool, of the logged actions."""
    from odaf.deployment.make_guard import parts_of

    parts = parts_of(guarded.score, guarded.policy, dataset).max(axis=1)
    return ~(np.maximum.reduceat(parts, dataset.episode_starts) <= guarded.calibration.threshold)


def _share(flags: np.ndarray) -> float:
    return float(np.mean(flags)) if len(flags) else 0.0


def _avoided(figures: Any) -> float | None:
    """Of all disturbances together."""
    found = list(figures)
    falls = sum(each["falls"] for each in found)
    return (falls - sum(each["falls_guarded"] for each in found)) / falls if falls else None


def plan() -> list[Phase]:
    """A phase for each robot."""
    return [Phase(robot, (Job(robot, Guarding(robot)),)) for robot in ROBOTS]


def table(records: Sequence[Record]) -> str:
    """Markdown: a row for each robot and rate; then one for each robot and disturbance."""
    lines = [
        f"Guards of policies on {LOCAL}, calibrated by episode. Alarms are counted in fresh episodes of whoever",
        "wrote the log, for which the rate is promised, and of the policy. Made by `odaf reproduce guard` from the",
        "records in this folder.",
        "",
        "| robot | asked for | behaviour's episodes | policy's episodes | detected | falls avoided |",
        "|---|---|---|---|---|---|",
    ]
    for record in records:
        for rate, each in record["rates"].items():
            cannot = "nothing fell" if record["robot"] in FALLS else "does not fall"
            avoided = cannot if each["falls_avoided"] is None else f"{each['falls_avoided']:.0%}"
            lines.append(
                f"| {record['robot']} | {float(rate):.0%} | {each['false_alarms']:.1%} "
                f"| {each['false_alarms_policy']:.1%} | {each['detected']:.0%} | {avoided} |"
            )
    rates = list(dict.fromkeys(rate for record in records for rate in record["rates"]))
    asked = [f"{float(rate):.0%}" for rate in rates]
    lines += [
        "",
        "What happens in the steps after a disturbance, at each rate that was asked for: episodes with an alarm, and",
        "episodes that fall. Knocks take the controls away for so many simulator steps; attacks by min-q move what is",
        "seen by so many standard deviations, from then on. On an alarm the cloned behaviour acts.",
        "",
        f"| robot | disturbance | episodes | {' | '.join(f'alarm, {rate}' for rate in asked)} | falls unguarded "
        f"| {' | '.join(f'guarded, {rate}' for rate in asked)} |",
        f"|{'---|' * (4 + 2 * len(rates))}",
    ]
    for record in records:
        by_rate = [record["rates"][rate]["by_disturbance"] for rate in rates]
        for kind, each in by_rate[0].items():
            alarms = " | ".join(f"{figures[kind]['detected']:.0%}" for figures in by_rate)
            falls = " | ".join(str(figures[kind]["falls_guarded"]) for figures in by_rate)
            lines.append(f"| {record['robot']} | {kind} | {each['episodes']} | {alarms} | {each['falls']} | {falls} |")
    return "\n".join(lines) + "\n"


def summary(records: Sequence[Record]) -> str:
    """JSON: by robot and rate the shares of false alarms, of disturbed episodes detected, and of falls avoided."""
    names = ("false_alarms", "false_alarms_policy", "detected", "falls_avoided", "by_disturbance")
    found = {
        record["robot"]: {
            rate: {**{name: each[name] for name in names}, "episodes": record["episodes"]}
            for rate, each in record["rates"].items()
        }
        for record in records
    }
    return json.dumps(found, indent=1) + "\n"


STUDY = Study(
    "guard",
    "false alarms of a guard in sound episodes, and what it sees and saves in knocked and attacked ones",
    plan,
    {"table.md": table, "summary.json": summary},
)
