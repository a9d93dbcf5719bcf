"""What the policies of a run earn when they are knocked, or start from unusual states; and how they come back."""

import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from odaf.data import fingerprint
from odaf.data.dataset import Dataset
from odaf.environments.contact_margins import ContactMargins
from odaf.environments.knocks import Knock, Knocked, UnusualStart
from odaf.environments.reference_returns import reference_of
from odaf.environments.registry import make_untimed
from odaf.errors import ConfigError, DatasetError
from odaf.evaluation.recovery import KnownGround
from odaf.evaluation.rollouts import Environment, Episodes, rollout
from odaf.evaluation.scores import Scores
from odaf.evaluation.statistics import Estimate
from odaf.runs.trial import Trial
from odaf.training.data_search import places
from odaf.training.run_directory import RunDirectory

COUNTED_STEPS = 1000
"""Counted steps of an episode in an environment that has no time limit of its own."""


@dataclass(frozen=True)
class Recovery:
    """How long the policies took to come back to logged ground, over the disturbed episodes of all seeds.

    Attributes:
        median: steps; infinite where more than half of the episodes ended before they were back.
        recovered_rate: share of the episodes that came back.
        episodes: that were disturbed, so not those that had fallen before the knock.
        threshold: distance to the nearest logged state, in normalised units, that counts as back.
        rows: logged states in the sample that distances are measured to.
    """

    median: float
    recovered_rate: float
    episodes: int
    threshold: float
    rows: int


@dataclass(frozen=True)
class KnockScores:
    """Scores under one disturbance.

    Attributes:
        knock: the knock; its `steps` are 0 for none.
        initial_noise: size of the noise on starting states, in standard deviations.
        counted_steps: most steps of an episode.
        scores: of every seed, with `survived_rate` (no true end in the counted steps) and `knocked_rate`.
        recovery: None where nothing was disturbed or it could not be measured.
        no_recovery: why it could not be measured; empty if it was, or where nothing was disturbed.
    """

    knock: Knock
    initial_noise: float
    counted_steps: int
    scores: Scores
    recovery: Recovery | None
    no_recovery: str

    @property
    def normalised(self) -> Estimate | None:
        """Normalised score with its 95 % interval over seeds; None without reference returns."""
        environment = self.scores.environment
        reference = None if environment is None else reference_of(environment)
        return None if reference is None else self.scores.estimate().rescaled(reference.random, reference.expert)

    def to_dict(self) -> dict[str, Any]:
        """JSON types; a median that is infinite becomes null when it is written."""
        scores = self.scores.to_dict()
        if self.normalised is not None:
            scores["normalised"]["interval"] = [self.normalised.low, self.normalised.high]
        recovery = self.recovery
        return {
            "knock": {"steps": self.knock.steps, "at": self.knock.at, "action": self.knock.action},
            "initial_noise": self.initial_noise,
            "counted_steps": self.counted_steps,
            **scores,
            "recovery": None if recovery is None else dict(vars(recovery)),
            **({"no_recovery": self.no_recovery} if self.no_recovery else {}),
        }


def knock_scores(
    directory: str | os.PathLike[str],
    knock: Knock,
    *,
    initial_noise: float = 0.0,
    data: str | os.PathLike[str] | None = None,
    episodes: int = 50,
    seed: int = 0,
    step: int | None = None,
    environment: str | None = None,
    contact_margins: ContactMargins | None = None,
) -> KnockScores:
    """Play episodes with every seed of a run while something puts the policy off; nothing in its directory changes.

    An episode has as many counted steps as the environment's time limit, or 1,000 where it has none. The steps of the
    knock are not among them.

    Args:
        directory: a run's directory.
        knock: the knock; `Knock(steps=0)` is none.
        initial_noise: noise on starting states, in standard deviations of the logged observations.
        data: file of the run's training data, for the recovery time; None takes the path that the run remembers. If
            that file is not there any more, or not the same, the recovery time is left out and the reason told.
        episodes: episodes for each seed.
        seed: chooses the starts, knocks and noise.
        step: the checkpoint after so many updates; None takes each seed's last.
        environment: a gymnasium id; None takes the run's own.
        contact_margins: as in `odaf.evaluate`.

    Raises:
        CheckpointError: as `odaf.evaluate`.
        ConfigError: as `odaf.evaluate`; or the knock comes too late for the environment, or starting states of this
            environment cannot be changed.
        DatasetError: `data` is given and is not what the run was trained on.
    """
    trial = Trial.of(
        directory, episodes=episodes, seed=seed, step=step, environment=environment, contact_margins=contact_margins
    )
    if trial.examined.derivation is not None:
        raise ConfigError(
            "knock: how far a policy is from logged ground is measured in its observations, and environment "
            f"{trial.rollouts.name} gives the readings that these are computed of; name one that gives the "
            "observations themselves with --env, or evaluate without a knock"
        )
    build, limit = make_untimed(trial.environment)
    counted = trial.rollouts.max_steps or limit or COUNTED_STEPS
    ground, reason = None, ""
    if knock.steps or initial_noise:
        ground, reason = _known_ground(trial.run, data)
    make_env = partial(_disturbed, build, knock, initial_noise, trial.run.normaliser.std, counted)
    played = {policy_seed: rollout(policy, make_env, episodes, seed) for policy_seed, policy in trial.policies()}
    recovery = None if ground is None else _recovery(ground, list(played.values()), knock)
    if ground is not None and recovery is None:
        reason = "no episode lasted until the knock"
    return KnockScores(knock, initial_noise, counted, trial.scores(played), recovery, reason)


def _disturbed(build: Any, knock: Knock, noise: float, std: np.ndarray, counted: int) -> Environment:
    environment = build()
    return Knocked(UnusualStart(environment, noise, std) if noise else environment, knock, counted)


def _known_ground(run: RunDirectory, data: str | os.PathLike[str] | None) -> tuple[KnownGround | None, str]:
    """The ground, or why there is none; a file that the caller named must do."""
    looked = places(run) if data is None else [Path(data)]
    if not looked:
        return None, "the run's data came from memory; give their file with --data"
    try:
        path = next((place for place in looked if place.exists()), None)
        if path is None:
            names = ", ".join(map(str, looked))
            raise DatasetError(f"{names}: the run's data are not there any more; give their file with --data")
        dataset = Dataset.load(path)
        if fingerprint.differing(dataset, run.data) is not None:
            raise DatasetError(f"{path}: is not what the run was trained on; give the file it was, with --data")
        return KnownGround.of(dataset, run.normaliser), ""
    except DatasetError as error:
        if data is not None:
            raise
        return None, str(error)


def _recovery(ground: KnownGround, played: list[Episodes], knock: Knock) -> Recovery | None:
    times = []
    for episodes in played:
        observations = episodes.observations
        if knock.steps:
            observations = observations[episodes.flags["knocked"], knock.at :]
        times.append(ground.recovery(observations))
    steps = np.concatenate(times)
    if steps.size == 0:
        return None
    rate = float(np.isfinite(steps).mean())
    return Recovery(float(np.median(steps)), rate, len(steps), ground.threshold, ground.rows)
