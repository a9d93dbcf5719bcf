"""The knocks study: does a policy come back once it was put where its log has hardly been?

The controls are taken away for some simulator steps in the middle of an episode, or the episode begins in an unusual
pose. Scores, survivors, steps until the policy is back on logged ground; and where it goes after the large knock.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from odaf.studies import knocks_table
from odaf.studies.job import Phase, Record, Study
from odaf.studies.of_policy import OfPolicy, phase_of
from odaf.studies.robots import ROBOTS, robot_form, robot_task
from odaf.studies.task import Evaluation
from odaf.studies.training import Training

if TYPE_CHECKING:
    from odaf.evaluation.runs import Run
    from odaf.training.progress import ProgressReport

STEPS, SEEDS = 50_000, 4
EVALUATION = Evaluation(every=10_000, episodes=10)
LEVELS = {"none": 0, "slight": 5, "moderate": 10, "large": 15, "20 steps": 20, "extra-large": 30}
NOISES = (0.05, 0.1, 0.2)
AT, EARLY = 500, 100
"""Counted step of the knock: the protocol's, and one that policies reach which fall before that."""
POINTS, GRID = 300, 40

OURS = ("odaf-locomotion", "odaf-locomotion-without-outcome", "behaviour-cloning")
PAPER = ("odaf-paper", "odaf-paper-without-outcome")
RIVALS = ("osr-10", "sdc")


@dataclass(frozen=True)
class Knocking(OfPolicy):
    """Scores of a policy under every knock and from every kind of unusual start, and its states after the large one.

    Attributes:
        at: counted step of the knock.
        levels: simulator steps of each knock, by name; "none" is among them, and "large".
        noises: sizes of the noise on starting states, in standard deviations of the log.
        episodes: of each.
        followed: steps after the knock whose states are looked at.
    """

    at: int = AT
    levels: tuple[tuple[str, int], ...] = tuple(LEVELS.items())
    noises: tuple[float, ...] = NOISES
    episodes: int = 20
    followed: int = 100

    measure_name = "knocked"

    @property
    def name(self) -> str:
        return f"{super().name}-{self.at}"

    @property
    def labels(self) -> dict[str, tuple[str, ...]]:
        return super().labels | {"at": (f"at-{self.at}",)}

    def settings(self) -> dict[str, Any]:
        return {
            "at": self.at,
            "levels": dict(self.levels),
            "noises": list(self.noises),
            "episodes": self.episodes,
            "followed": self.followed,
        }

    def guess(self) -> float:
        return 300.0

    def said(self, record: Record) -> str:
        if record["found"] is None:
            return "the policy diverged"
        levels = record["found"]["levels"]
        return f"{levels['none']['score']:.1f}, knocked {levels['large']['score']:.1f}"

    def measure(self, run: "Run", place: Path, progress: "ProgressReport") -> Mapping[str, Any]:
        from odaf.environments.knocks import Knock
        from odaf.runs.evaluate_knocks import knock_scores

        data = self.log.present(place)
        progress.start("knocks", len(self.levels) + len(self.noises) + 1, unit="disturbances")
        levels, starts = {}, {}
        for number, (name, steps) in enumerate(self.levels):
            levels[name] = _kept(knock_scores(run.directory, Knock(steps, self.at), data=data, episodes=self.episodes))
            progress.advance(number + 1)
        for number, noise in enumerate(self.noises):
            found = knock_scores(run.directory, Knock(0), initial_noise=noise, data=data, episodes=self.episodes)
            starts[str(noise)] = _kept(found)
            progress.advance(len(self.levels) + number + 1)
        after = self._after(run, data)
        progress.close()
        return {"levels": levels, "starts": starts, "after": after}

    def _after(self, run: "Run", data: Path) -> Mapping[str, Any] | None:
        """Where the policy goes after the large knock; None where no episode lasts until then."""
        from odaf.data.dataset import Dataset
        from odaf.environments.knocks import Knock, Knocked
        from odaf.environments.registry import make_untimed
        from odaf.evaluation.knocked_states import knocked_states
        from odaf.evaluation.recovery import KnownGround
        from odaf.evaluation.rollouts import rollout

        dataset, normaliser = Dataset.load(data), run.files.normaliser
        build, _ = make_untimed(run.data["environment"])
        knock = Knock(dict(self.levels)["large"], self.at)
        episodes = rollout(
            run.policy(self.training.seed),
            lambda: Knocked(build(), knock, self.at + self.followed),
            self.episodes,
        )
        seen = episodes.observations[episodes.flags["knocked"], self.at : self.at + self.followed + 1]
        # Where all fall, nothing is played to the end; the steps that are missing are no return.
        missing = self.followed + 1 - seen.shape[1]
        seen = np.pad(seen, ((0, 0), (0, missing), (0, 0)), constant_values=np.nan)
        ground = KnownGround.of(dataset, normaliser)
        found = knocked_states(dataset, normaliser, ground, seen)
        if found is None:
            return None
        low, high = np.percentile(found.log, [0.5, 99.5], axis=0)
        counts, *_ = np.histogram2d(*found.log.T, bins=GRID, range=list(zip(low, high, strict=True)))
        shown = found.points[np.linspace(0, len(found.points) - 1, min(POINTS, len(found.points))).astype(int)]
        back = np.isfinite(found.recovery)
        return {
            "episodes": found.episodes,
            "beyond": found.beyond,
            "recovered": float(back.mean()),
            "median_recovery": float(np.median(found.recovery)) if back.mean() > 0.5 else None,
            "points": np.round(shown, 3).tolist(),
            "log": {"low": low.tolist(), "high": high.tolist(), "counts": counts.astype(int).tolist()},
        }


def _kept(found: Any) -> dict[str, Any]:
    score = found.normalised
    assert score is not None
    by_seed, recovery = found.scores.by_seed[0], found.recovery
    return {
        "score": score.mean,
        "return": by_seed.mean_return,
        **{name: by_seed.rates.get(name) for name in ("survived_rate", "knocked_rate")},
        "recovered": None if recovery is None else recovery.recovered_rate,
        "median_recovery": None if recovery is None or not np.isfinite(recovery.median) else recovery.median,
    }


def plan(data: Path | None = None) -> list[Phase]:
    """Policies that walk first; the protocol's own log, medium-expert, before medium."""

    def works(presets: Sequence[str], robots: Sequence[str], kind: str, at: int) -> list[Knocking]:
        found = []
        for seed in range(SEEDS):
            for robot in robots:
                task = robot_task(robot, kind, EVALUATION, data=data)
                for preset in presets:
                    form = robot_form(preset, task)
                    found.append(Knocking(Training(preset, task, seed, STEPS, form=form), at))
        return found

    phases: list[Phase] = []
    for title, some in (
        ("Hopper, medium-expert: our form, its base, cloning", works(OURS, ROBOTS[:1], "medium-expert", AT)),
        ("the other robots, medium-expert", works(OURS, ROBOTS[1:], "medium-expert", AT)),
        ("medium logs, knocked early", works(OURS, ROBOTS, "medium", EARLY)),
        ("OSR-10 and SDC, medium-expert", works(RIVALS, ROBOTS, "medium-expert", AT)),
        ("the paper's form and its base, medium-expert", works(PAPER, ROBOTS, "medium-expert", AT)),
    ):
        phases.append(phase_of(title, some, phases))
    return phases


def study(data: Path | None = None) -> Study:
    """On logs made here, or on public files."""
    return Study(
        "knocks",
        "whether policies come back from states outside the data",
        partial(plan, data),
        {"table.md": knocks_table.table, "summary.json": knocks_table.summary},
        {"figure.png": knocks_table.figure},
        knocks_table.CLAIM,
        on_files=study,
    )


STUDY = study()
