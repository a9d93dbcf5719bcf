"""The policies of a run, and where and how often they are to be tried."""

import os
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from odaf.environments.contact_margins import ContactMargins, recorded, warn_if_other
from odaf.errors import ConfigError
from odaf.evaluation.examination import Examined, examine
from odaf.evaluation.rollouts import Episodes, MakeEnvironment, Rollouts, summarise
from odaf.evaluation.scores import Scores, scores_from
from odaf.training.policy import Policy
from odaf.training.run_directory import RunDirectory
from odaf.training.settings import products_in


@dataclass(frozen=True)
class Trial:
    """The policies of a run, and where and how often they are to be tried; nothing in the run's directory changes.

    Attributes:
        run: the run.
        rollouts: the environment, described in full, with the number of episodes and their seed.
        step: the checkpoint after so many updates; None takes each seed's last.
    """

    run: RunDirectory
    rollouts: Rollouts
    step: int | None

    @classmethod
    def of(
        cls,
        directory: str | os.PathLike[str],
        *,
        episodes: int,
        seed: int,
        step: int | None,
        environment: str | Mapping[str, Any] | MakeEnvironment | None,
        contact_margins: ContactMargins | None = None,
    ) -> "Trial":
        """See `evaluate` for the arguments and what is raised."""
        run = RunDirectory(Path(directory))
        settings = run.config.get("evaluate") or {}
        known = settings.get("environment") or run.data["environment"]
        if environment is None and known is None:
            raise ConfigError(
                f"{run.path}: neither the run nor its data set names an environment to play in; "
                "give one, as --env Hopper-v5"
            )
        rollouts = Rollouts(environment, episodes=episodes, seed=seed, max_steps=settings.get("max_steps"))
        trial = cls(run, replace(rollouts, contact_margins=contact_margins).resolved(known), step)
        warn_if_other(recorded(run.data["summary"]["provenance"]), trial.examined.simulator)
        return trial

    @property
    def environment(self) -> Mapping[str, Any]:
        """The full description, for `odaf.environments.make`.

        Raises:
            ConfigError: the environment is a class or function, which has none.
        """
        if isinstance(self.rollouts.environment, Mapping):
            return self.rollouts.environment
        raise ConfigError(f"environment {self.rollouts.name}: is a class or function; here only a description will do")

    @property
    def environment_id(self) -> str | None:
        """Gymnasium's name of the environment, if it has one."""
        environment = self.rollouts.environment
        return environment.get("id") if isinstance(environment, Mapping) else None

    @cached_property
    def examined(self) -> Examined:
        """The environment, found to fit the run's data.

        Raises:
            ConfigError: it does not.
        """
        names, rollouts = self.run.data["summary"]["observation_names"], self.rollouts
        return examine(rollouts.maker(), rollouts.name, self.run.spec, names, rollouts.rule, self.run.derivation)

    def policies(self) -> Iterator[tuple[int, Policy]]:
        """Every training seed with what it had learned, on what the environment gives."""
        for seed in self.run.seeds:
            yield seed, self.policy(seed)

    def policy(self, seed: int) -> Policy:
        """What one training seed had learned, on what the environment gives."""
        return self.examined.fitting(self.run.policy(seed, self.run.checkpoint(seed, self.step).step))

    def scores(self, played: Mapping[int, Episodes]) -> Scores:
        """Scores of every seed from the episodes that its policy played."""
        summaries: dict[int, dict[str, Any]] = {}
        notes = []
        for seed, episodes in played.items():
            summed = summarise(episodes)
            stated = {"step": self.run.checkpoint(seed, self.step).step, "simulator": self.examined.simulator}
            lengths = {"lengths": episodes.lengths.tolist()}
            flags = {name: flag.tolist() for name, flag in episodes.flags.items()}
            summaries[seed] = {"evaluation": stated | summed.summary | {"by_episode": lengths | flags}}
            notes += [f"seed {seed}: {sentence}" for sentence in summed.warnings.values()]
        scores = scores_from(summaries, str(self.run.path), self.environment_id)
        return replace(scores, notes=tuple(notes))

    def precision(self) -> AbstractContextManager[object]:
        """A context in which policies act as they did when the run evaluated them."""
        return products_in(self.run.config.get("precision"))
