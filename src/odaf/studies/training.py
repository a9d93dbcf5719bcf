"""The commonest work of a study: train one policy on a task's log, and score its last checkpoint."""

import json
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odaf.errors import ConfigError, DivergenceError
from odaf.studies.identity import LEARNER_VERSIONS, by_name, todays_learner
from odaf.studies.job import PRINTS, DataEntries, Job, Log, Phase, Record, Work, prints_of, short_print
from odaf.studies.logs import LOCAL
from odaf.studies.task import Task

if TYPE_CHECKING:
    from odaf.evaluation.runs import Run
    from odaf.report.quantities import Trajectories
    from odaf.training.progress import ProgressReport


MOST_PLACES = 100  # of an episode's path in a record
UPDATES_PER_SECOND: dict[str, float] = {
    **{"behaviour-cloning": 250.0, "behaviour-cloning-best": 300.0, "td3-bc": 140.0, "iql": 120.0, "svr": 150.0},
    **{"rebrac-return": 80.0, "rebrac": 25.0, "odaf-light": 70.0, "odaf-light-without-outcome": 80.0},
    **{"odaf-anchored": 100.0, "odaf-anchored-without-outcome": 110.0},
}
"""Of presets, on one core of a machine with other work; others make about forty, as ten critics of two layers of 256
do. For guesses alone: where records are, they say what a run costs."""


@dataclass(frozen=True)
class Training(Work):
    """One policy to train and score; its record holds scores, settings, versions and the data's fingerprint.

    Attributes:
        preset: its name.
        task: what to learn.
        seed: of the training.
        steps: updates to make.
        changes: settings other than the preset's and the task's, by dotted name.
        form: settings that keep the preset in the form that the study is about; no part of the method's name.
        setting: of the task, whose values of the preset are taken, as in "attack" for those of `hopper-medium-attack`;
            part of the method's name.
        notes: further entries of the record, for a study's tables.
        checkpoint_every: updates between two checkpoints; a run that is stopped loses no more.
        paths: episodes of the last evaluation whose paths in the plane the record keeps.
    """

    preset: str
    task: Task
    seed: int
    steps: int
    changes: tuple[tuple[str, Any], ...] = ()
    form: tuple[tuple[str, Any], ...] = ()
    setting: str | None = None
    notes: tuple[tuple[str, Any], ...] = ()
    checkpoint_every: int = 5_000
    paths: int = 0

    @property
    def method(self) -> str:
        """The preset and what is changed in it, as in `odaf-return_steps-5`."""
        setting = [] if self.setting is None else [self.setting]
        return "-".join([self.preset, *setting, *(f"{field}-{value}" for field, value in self.changes)])

    @property
    def title(self) -> str:
        """What lies in one directory, however many updates it has made."""
        return f"{self.task.name}-{self.method}-seed{self.seed}"

    @property
    def name(self) -> str:
        """That of its record."""
        return f"{self.title}-{self.steps}"

    @property
    def log(self) -> Log:
        return self.task.log

    @property
    def labels(self) -> dict[str, tuple[str, ...]]:
        return {"method": (self.preset, self.method), "task": (self.task.name,)}

    @property
    def line(self) -> str:
        return self.title

    @property
    def amount(self) -> float:
        return float(self.steps)

    def amount_done(self, place: Path) -> float:
        if next(place.glob(f"{self.title}-*"), None) is None:  # thousands of plans: their identities take half a minute
            return 0.0
        checkpoints = self.directory(place) / f"seed-{self.seed}" / "checkpoints"
        made = [int(path.name) for path in checkpoints.glob("*") if path.name.isdigit()]
        return float(min(max(made, default=0), self.steps))

    def likeness(self) -> tuple[Hashable, ...]:
        task, method, preset = ("task", self.task.name), ("method", self.method), ("preset", self.preset)
        return (("run", self.title), (task, method), method, (task, preset), preset)

    def guess(self) -> float:
        return 1.0 / UPDATES_PER_SECOND.get(self.preset, 40.0)

    def said(self, record: Record) -> str:
        final = record["final"]
        if final is None:
            return f"diverged after {record['updates']:,} updates"
        return f"{final['mean_return']:.1f} +- {final['std_return']:.1f}"

    def learner(self) -> Any:
        """The preset with its values for the task, where it has some, then what the task's learners share, then the
        form, then the changes."""
        from odaf.runs import presets

        known = self.task.log.known_as
        task = known if self.setting is None else f"{known}-{self.setting}"
        if self.setting is None and task not in presets.tasks(self.preset):
            task = None
        return presets.load(self.preset, {**dict(self.task.common), **dict(self.form), **dict(self.changes)}, task=task)

    def identity(self) -> dict[str, Any]:
        from odaf.algorithms import config

        learner = config.to_dict(self.learner())
        return {
            "learner": by_name(learner),
            "learner_version": LEARNER_VERSIONS.get(learner["kind"], 1),
            "data": {"print": "known", **self.log.recipe()},
            "evaluation": self.task.settings(),
            "seed": self.seed,
            "steps": self.steps,
        }

    def recorded(self, record: Record, data: DataEntries) -> dict[str, Any]:
        prints, entry = prints_of(record["data"]), data.get(self.task.name, {"recipe": {}, "sha256": []})
        known = "known" if set(prints) & set(entry["sha256"]) else f"{prints[0][:8]}, not in data.json"
        final = record["final"]
        stated = {
            **({} if final is None else {"final_episodes": final["episodes"]}),
            **record.get("identity", {}).get("evaluation", {}),
        }
        return {
            **record.get("identity", {}),
            "learner": todays_learner(record["algorithm"]),
            "data": {"print": known, **entry["recipe"]},
            "evaluation": stated,
            "seed": record["seed"],
            "steps": record["steps"],
        }

    def unrecorded(self) -> dict[str, Any]:
        # The records of the first studies, made before they said what they were.
        evaluation = self.task.evaluation
        first = {"version": 1, "every": 5_000, "episodes": 50 if evaluation.final_episodes is None else 10}
        final = {"final_episodes": self.task.settings()["final_episodes"]}  # a diverged run played none
        return {"learner_version": 1, **{f"evaluation.{name}": value for name, value in (first | final).items()}}

    def directory(self, place: Path) -> Path:
        """Where the run lies; one with other settings, data or evaluation lies elsewhere."""
        identity = {name: value for name, value in self.identity().items() if name != "steps"}
        return place / f"{self.title}-{short_print(identity)}"

    def do(self, place: Path, progress: "ProgressReport") -> Record:
        run = self.trained(place, progress)
        summary = run.summary[self.seed]
        versions = json.loads((run.directory / "environment.json").read_text(encoding="utf-8"))
        record = {
            self.task.field: self.task.name,
            "preset": self.preset,
            "changes": dict(self.changes),
            "method": self.method,
            **dict(self.notes),
            "seed": self.seed,
            "steps": self.steps,
            "updates": summary["step"],
            "status": summary["status"],
            "data": {
                "origin": LOCAL,
                **{kind: run.data[kind] for kind in PRINTS if kind in run.data},
                **self.task.log.figures(run),
            },
            "final": None if summary["status"] == "diverged" else self._final(run, summary["evaluation"]),
            "evaluations": [
                _evaluation(line) for line in run.files.metrics(self.seed) if "evaluation/return_mean" in line
            ],
            "updates_per_second": summary["updates_per_second"],
            "seconds": summary["seconds"],
            "pretrain": summary["pretrain"],
            "warnings": summary["warnings"],
            "algorithm": run.config["algorithm"],
            "identity": {name: self.identity()[name] for name in ("learner_version", "evaluation")},
            "versions": {
                key: versions[key]
                for key in ("python", "versions", "device", "platform", "precision")
                if key in versions  # precision is younger than some runs
            },
        }
        if self.paths and record["final"] is not None:
            record["paths"] = _paths(run, self.seed, self.paths)
        if run.config.get("lanes", 1) > 1:
            record["lanes"] = run.config["lanes"]
        return self._normalised(record, run) if self.task.score == "normalised_score" else record

    def trained(self, place: Path, progress: "ProgressReport") -> "Run":
        """The run after `steps` updates: trained, gone on with after a stop, made longer, or found complete. One whose
        parameters are no longer finite numbers ends there.

        Raises:
            DivergenceError: it was lost before the first update.
        """
        from odaf.evaluation import Rollouts
        from odaf.runs.fit import fit, load_run, resume

        directory, begun = self.directory(place), False
        if (directory / "config.json").exists():
            made_for = load_run(directory).config["steps"]
            if made_for > self.steps:  # the longer one is there: this one is trained beside it
                directory = directory.with_name(f"{directory.name}-{self.steps}")
            else:
                begun = made_for < self.steps
        try:
            if begun:
                return resume(directory, self.steps, progress=progress)
            return fit(
                self.learner(),
                self.log.present(place),
                steps=self.steps,
                seeds=[self.seed],
                directory=directory,
                evaluate=Rollouts(episodes=self.task.evaluation.episodes, every=self.task.evaluation.every),
                checkpoint_every=self.checkpoint_every,
                preset=self.preset,
                progress=progress,
            )
        except DivergenceError:
            if not (directory / "config.json").exists():
                raise
            run = load_run(directory)
            if run.summary[self.seed]["status"] != "diverged":
                raise
            return run

    def _final(self, run: "Run", last: dict[str, Any]) -> dict[str, Any]:
        from odaf.runs.evaluate import evaluate

        episodes = self.task.evaluation.final_episodes
        if episodes is None:
            return last
        score = evaluate(run.directory, episodes=episodes).by_seed[0]
        return {
            "step": score.step,
            "episodes": episodes,
            "mean_return": score.mean_return,
            "std_return": score.std_return,
            **score.rates,
            "returns": list(score.returns),
        }

    def _normalised(self, record: Record, run: "Run") -> Record:
        from odaf.environments.reference_returns import reference_of

        environment = run.data["environment"]["id"]
        reference = reference_of(environment)
        if reference is None:
            raise ConfigError(
                f"{self.task.name}: {environment} has no reference returns, so it has no normalised score"
            )
        for scored in (*record["evaluations"], *([] if record["final"] is None else [record["final"]])):
            scored["normalised_score"] = reference.normalise(scored["mean_return"])
        return {self.task.field: self.task.name, "environment": environment, **record}


def _evaluation(line: Mapping[str, Any]) -> dict[str, Any]:
    rates = {name: value for name, value in line.items() if name.startswith("evaluation/") and name.endswith("_rate")}
    return {
        "step": line["step"],
        "mean_return": line["evaluation/return_mean"],
        "std_return": line["evaluation/return_std"],
        **{name.removeprefix("evaluation/"): value for name, value in rates.items()},
    }


def _paths(run: "Run", seed: int, count: int) -> dict[str, Any]:
    """Of so many episodes of the last evaluation every fourth place, or a hundred, and whether they did what counts:
    one text an episode, so that a record stays short."""
    from odaf.report.quantities import FLAGS

    recorded = run.files.episodes(seed)
    if recorded is None:
        return {"places": []}
    _, arrays = recorded
    observations = arrays["observations"]
    every = max(4, observations.shape[1] // MOST_PLACES)
    whole = observations[:count, :, :2].round(2).tolist()
    places = [[place for place in path if place[0] == place[0]] for path in whole]  # NaN stands after an episode's end
    kept = [[*path[:-1:every], path[-1]] for path in places]
    flag = next((name for name in FLAGS if name in arrays), None)
    return {
        "places": [" ".join(f"{x:g},{y:g}" for x, y in path) for path in kept],
        **({} if flag is None else {flag: [bool(value) for value in arrays[flag][:count]]}),
    }


def kept_paths(record: Mapping[str, Any]) -> "Trajectories":
    """The paths that a record keeps."""
    import numpy as np

    from odaf.report.paths import stacked
    from odaf.report.quantities import FLAGS, Trajectories

    kept = record["paths"]
    places = [np.array([[step.split(",") for step in text.split()]], float) for text in kept["places"]]
    for flag, doing in FLAGS.items():
        if kept.get(flag) is not None:
            return Trajectories(stacked(places), np.array(kept[flag], bool), doing)
    return Trajectories(stacked(places))


def phases_of(*parts: tuple[str, list[Training]]) -> list[Phase]:
    """Phases of trainings, each in the order in which they are worth doing: the first seed of every method on the first
    task, then of the other tasks, then the second seed. A longer run comes after the same one of fewer updates.

    Args:
        parts: title and trainings of each phase.
    """
    phases, lines = [], dict[str, list[str]]()
    for title, trainings in parts:
        tasks = list(dict.fromkeys(training.task.name for training in trainings))
        jobs = []
        for training in sorted(trainings, key=lambda one: (one.seed, tasks.index(one.task.name), one.steps)):
            earlier = lines.setdefault(training.title, [])
            jobs.append(Job(training.name, training, tuple(earlier)))
            earlier.append(training.name)
        phases.append(Phase(title, tuple(jobs)))
    return phases
