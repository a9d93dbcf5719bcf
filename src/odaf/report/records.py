"""What a run directory holds, read from its files alone: nothing is loaded that could run code.

A run may still be going, may have been killed, or may never have been evaluated. Whatever is there is read; whatever is
absent is `None` or empty, so that a report can name it. A file that is there but cannot be read is an error.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from odaf.errors import ConfigError
from odaf.training.logging import Series
from odaf.training.run_directory import RunDirectory

LOCAL = "locally generated data"


@dataclass(frozen=True)
class Evaluation:
    """The outcome of one evaluation of one seed.

    Attributes:
        step: updates before it.
        mean: mean undiscounted return over the episodes.
        std: standard deviation over the episodes.
        episodes: their number, 0 where the run does not tell.
        success_rate: share that reached the target, `None` where the environment reports no success.
        stitched_rate: share that reached the target without a logged detour, `None` where there is no such flag.
        returns: [episodes] each sound episode's return, `None` where the run does not tell.
    """

    step: int
    mean: float
    std: float
    episodes: int
    success_rate: float | None
    stitched_rate: float | None
    returns: np.ndarray | None


@dataclass(frozen=True)
class SeedRecord:
    """One seed of a run.

    Attributes:
        seed: its number.
        files: the run it belongs to.
        series: logged quantities by name, for example `critic/mean`.
        summary: where the seed stands.
    """

    seed: int
    files: RunDirectory
    series: Mapping[str, Series]
    summary: Mapping[str, Any]

    @property
    def status(self) -> str:
        """What the run says of itself, such as "finished"; "unfinished" for one that is running or was cut off."""
        status = str(self.summary.get("status", "running"))
        return "unfinished" if status in ("running", "not started") else status

    @property
    def step(self) -> int:
        """Updates made so far, as far as the files show."""
        logged = [int(series.steps[-1]) for series in self.series.values() if series.steps.size]
        return max([int(self.summary.get("step") or 0), *logged])

    @cached_property
    def evaluation(self) -> Evaluation | None:
        """The latest evaluation, whichever file tells of it; never the best one."""
        found = [self._summarised_evaluation(), self._logged_evaluation(), self._recorded_evaluation()]
        # `max` keeps the first of equals, so the summary, which tells most, goes before the log and the arrays.
        evaluations = [evaluation for evaluation in found if evaluation is not None]
        return max(evaluations, key=lambda evaluation: evaluation.step) if evaluations else None

    @property
    def broken(self) -> bool:
        """Whether the last evaluation has no mean because each of its episodes broke off on a number that is not
        finite."""
        entry = self.summary.get("evaluation")
        return self.evaluation is None and isinstance(entry, Mapping) and entry.get("mean_return", 0) is None

    @cached_property
    def episodes(self) -> tuple[int, Mapping[str, np.ndarray]] | None:
        """Step and arrays of the latest recorded evaluation: observations [episodes, time, obs_dim], returns, flags."""
        return self.files.episodes(self.seed)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the divergence monitor said, in order."""
        return tuple(_warning_text(warning) for warning in self.summary.get("warnings") or ())

    def _summarised_evaluation(self) -> Evaluation | None:
        entry = self.summary.get("evaluation")
        if not isinstance(entry, Mapping) or entry.get("mean_return") is None:
            return None
        returns = entry.get("returns")
        return Evaluation(
            step=int(entry.get("step") or self.summary.get("step") or 0),
            mean=float(entry["mean_return"]),
            std=number(entry.get("std_return")),
            episodes=int(entry.get("episodes") or (len(returns) if returns else 0)),
            success_rate=optional(entry.get("success_rate")),
            stitched_rate=optional(entry.get("stitched_rate")),
            returns=_sound(returns) if returns else None,
        )

    def _logged_evaluation(self) -> Evaluation | None:
        means = self.series.get("evaluation/return_mean")
        if means is None or not math.isfinite(means.values[-1]):
            return None
        step = int(means.steps[-1])
        return Evaluation(
            step=step,
            mean=float(means.values[-1]),
            std=number(self._at("evaluation/return_std", step)),
            episodes=int(self._at("evaluation/episodes", step) or 0),
            success_rate=self._at("evaluation/success_rate", step),
            stitched_rate=self._at("evaluation/stitched_rate", step),
            returns=None,
        )

    def _recorded_evaluation(self) -> Evaluation | None:
        if self.episodes is None or "returns" not in self.episodes[1]:
            return None
        step, arrays = self.episodes
        returns = _sound(arrays["returns"])
        if not returns.size:
            return None
        rates = {name: float(np.mean(arrays[name])) if name in arrays else None for name in ("success", "stitched")}
        return Evaluation(
            step,
            float(returns.mean()),
            float(returns.std()),
            len(returns),
            rates["success"],
            rates["stitched"],
            returns,
        )

    def _at(self, name: str, step: int) -> float | None:
        series = self.series.get(name)
        if series is None or step not in series.steps:
            return None
        return optional(series.values[np.flatnonzero(series.steps == step)[-1]])


@dataclass(frozen=True)
class RunRecord:
    """One run directory: one method on one dataset, with one or more seeds.

    Attributes:
        directory: the run directory.
        config: `config.json`.
        data: `data.json`, empty where absent.
        machine: `environment.json`, empty where absent.
        sample: arrays of `data_sample.npz`, empty where absent.
        seeds: in ascending order.
    """

    directory: Path
    config: Mapping[str, Any]
    data: Mapping[str, Any]
    machine: Mapping[str, Any]
    sample: Mapping[str, np.ndarray]
    seeds: tuple[SeedRecord, ...]

    @property
    def method(self) -> str:
        """The preset's name, or else the algorithm's, or else the directory's."""
        algorithm = self.config.get("algorithm")
        named = [self.config.get("preset")]
        if isinstance(algorithm, Mapping):
            named += [algorithm.get("name"), algorithm.get("kind"), algorithm.get("algorithm")]
        return next((str(name) for name in named if name), self.directory.name)

    @property
    def summary_of_data(self) -> Mapping[str, Any]:
        """`Dataset.summary()` of the training data, empty where unknown."""
        summary = self.data.get("summary")
        return summary if isinstance(summary, Mapping) else {}

    @property
    def provenance(self) -> Mapping[str, Any]:
        """Where the training data came from, in the data's own words; empty where unknown."""
        provenance = self.summary_of_data.get("provenance")
        return provenance if isinstance(provenance, Mapping) else {}

    @property
    def origin(self) -> str:
        """`LOCAL` where a generator of ours made the data, so that no score passes for one on published data."""
        return LOCAL if self.provenance.get("generator") else ""

    @property
    def environment(self) -> Mapping[str, Any] | None:
        """The environment of the training data, if they name one."""
        environment = self.data.get("environment")
        return environment if isinstance(environment, Mapping) else None

    @property
    def data_environment_id(self) -> str | None:
        """Gymnasium's name of the environment of the training data, version included; `None` where it has none."""
        return _identity(self.environment)

    @property
    def evaluation_environment_id(self) -> str | None:
        """Gymnasium's name of where the run was evaluated, version included; `None` where it has none."""
        return _identity(self.evaluation_environment)

    @property
    def evaluation_environment(self) -> Mapping[str, Any] | None:
        """What the run was evaluated in, as its configuration or else its data describe it."""
        settings = self.config.get("evaluate")
        own = settings.get("environment") if isinstance(settings, Mapping) else None
        return own if isinstance(own, Mapping) else self.environment if own is None else None

    @property
    def logged_returns(self) -> np.ndarray | None:
        """[episodes] undiscounted return of every logged episode."""
        returns = self.sample.get("returns")
        return None if returns is None or returns.size == 0 else np.asarray(returns, np.float64)

    @property
    def data_mean(self) -> float | None:
        """Mean return of the logged episodes."""
        return self._data_figure("mean_return", np.mean)

    @property
    def data_best(self) -> float | None:
        """Return of the best logged episode."""
        return self._data_figure("best_return", np.max)

    @property
    def evaluated(self) -> tuple[SeedRecord, ...]:
        """The seeds that have an evaluation."""
        return tuple(seed for seed in self.seeds if seed.evaluation is not None)

    def _data_figure(self, name: str, compute: Any) -> float | None:
        value = optional(self.summary_of_data.get(name))
        if value is None and self.logged_returns is not None:
            return float(compute(self.logged_returns))
        return value


def data_prints(runs: Sequence[RunRecord]) -> list[str | None]:
    """What tells the runs' data apart: prints of rows, or of whole files where a run has only that; None if unknown."""
    rows = all("rows_sha256" in run.data for run in runs if run.data)
    return [run.data.get("rows_sha256" if rows else "sha256") for run in runs]


def environments(runs: Sequence[RunRecord]) -> list[str]:
    """Names of the different environments in which the runs were played, without those that are not known."""
    known = [run.evaluation_environment for run in runs if run.evaluation_environment is not None]
    # Two mazes of one name may differ, so what is compared is the whole description.
    different = {json.dumps(environment, sort_keys=True, default=str): environment for environment in known}
    return [environment_name(environment) for environment in different.values()]


def find_runs(paths: Sequence[Path]) -> list[Path]:
    """Run directories among `paths`, in order; a folder that holds runs stands for them, by name.

    Raises:
        ConfigError: a path does not exist, or is neither a run directory nor a folder of them.
    """
    if not paths:
        raise ConfigError("no run directory given: name at least one, for example runs/demo/odaf")
    runs: list[Path] = []
    for path in (Path(path) for path in paths):
        if not path.is_dir():
            what = "is a file" if path.exists() else "does not exist"
            raise ConfigError(f"{path}: {what}; expected a run directory, as written by `odaf train --out DIRECTORY`")
        inside = [] if (path / "config.json").exists() else sorted(child.parent for child in path.glob("*/config.json"))
        if not inside and not (path / "config.json").exists():
            raise ConfigError(
                f"{path}: not a run directory, config.json is missing (and no folder directly inside it has one). "
                "Give a directory written by `odaf train --out DIRECTORY`: it holds config.json, data.json and seed-*/"
            )
        runs += inside or [path]
    return list({run.resolve(): run for run in runs}.values())


def read_run(directory: Path) -> RunRecord:
    """Everything a report needs from one run directory.

    Raises:
        ConfigError: the directory is no run.
        CheckpointError: a file is damaged, or of a version that is not known; the message names it.
    """
    files = RunDirectory(Path(directory))
    if not (files.path / "config.json").exists():
        raise ConfigError(f"{directory}: not a run directory, config.json is missing")
    return RunRecord(
        directory=files.path,
        config=files.config,
        data=files.data if (files.path / "data.json").exists() else {},
        machine=files.machine,
        sample=files.sample,
        seeds=tuple(
            SeedRecord(seed, files, files.series(seed), files.summary(seed))
            for seed in sorted(files.seeds)
            if files.seed_directory(seed).is_dir()
        ),
    )


def _sound(returns: Any) -> np.ndarray:
    """The returns of the episodes that did not break off on a number that is not finite."""
    values = np.asarray(returns, np.float64)
    return values[np.isfinite(values)]


def number(value: Any) -> float:
    """A float; NaN for anything that is not a number."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        return math.nan
    return float(value)


def optional(value: Any) -> float | None:
    """A finite float, or `None`."""
    result = number(value)
    return result if math.isfinite(result) else None


def environment_name(environment: Mapping[str, Any]) -> str:
    """What an environment is called: Gymnasium's name, or its maze's, or its kind's."""
    maze = environment.get("maze")
    name = maze.get("name") if isinstance(maze, Mapping) else environment.get("name")
    return str(environment.get("id") or name or "one without a name")


def _identity(environment: Any) -> str | None:
    identity = environment.get("id") if isinstance(environment, Mapping) else None
    return str(identity) if identity else None


def _warning_text(warning: Any) -> str:
    if isinstance(warning, Mapping):
        return str(warning.get("message") or json.dumps(warning, sort_keys=True))
    return str(warning)
