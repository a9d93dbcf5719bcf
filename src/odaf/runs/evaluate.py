"""Measuring the policies of a run again: other episodes, another checkpoint, another environment."""

import os
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from odaf.environments.contact_margins import ContactMargins
from odaf.errors import ConfigError
from odaf.evaluation.rollouts import MakeEnvironment, rollout
from odaf.evaluation.scores import Scores
from odaf.runs.evaluate_apart import played_apart
from odaf.runs.trial import Trial


def evaluate(
    directory: str | os.PathLike[str],
    *,
    episodes: int = 50,
    seed: int = 0,
    step: int | None = None,
    environment: str | Mapping[str, Any] | MakeEnvironment | None = None,
    contact_margins: ContactMargins | None = None,
    workers: int = 1,
) -> Scores:
    """Play episodes with one checkpoint of every seed of a run; nothing in its directory changes.

    Args:
        directory: a run's directory.
        episodes: episodes for each seed.
        seed: chooses the starts, the same for every seed of the run.
        step: the checkpoint after so many updates; None takes each seed's last.
        environment: a gymnasium id (or `MODULE:ID`), a description, or a class or function without arguments that
            builds one; None takes the environment that the run was evaluated in, else its data set's.
        contact_margins: how MuJoCo counts the margins of geoms that touch, "added" or "larger"; None is as the
            environment's description says, or else as the installed MuJoCo does.
        workers: processes that play side by side, on processors alone; 1 plays in this one. A policy's episodes are
            played in one batch, or in parts where there are fewer policies than workers, and then the last digits may
            differ. The calling script must call `evaluate` below `if __name__ == "__main__":`.

    Raises:
        CheckpointError: there is no run, no such checkpoint, or a damaged one.
        ConfigError: no environment is known, policies of the run's data cannot be tried in it, or a number is out of
            range.
    """
    trial = Trial.of(
        directory, episodes=episodes, seed=seed, step=step, environment=environment, contact_margins=contact_margins
    )
    if workers < 1:
        raise ConfigError(f"workers={workers}: must be at least 1")
    if workers > 1:
        played = played_apart(trial, workers)
    else:
        with trial.precision():
            played = {
                policy_seed: rollout(policy, trial.examined.make_env, episodes, seed, trial.rollouts.max_steps)
                for policy_seed, policy in trial.policies()
            }
    scores = trial.scores(played)
    return replace(scores, notes=(*trial.examined.warnings.values(), *scores.notes))
