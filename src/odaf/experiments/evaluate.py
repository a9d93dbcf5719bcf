"""Measuring the policies of a run again: other episodes, another checkpoint, another environment."""

import os
from pathlib import Path

from odaf.environments.registry import make
from odaf.errors import ConfigError
from odaf.evaluation.rollouts import Rollouts, rollout, summarise
from odaf.evaluation.scores import Scores, scores_from
from odaf.training.run_directory import RunDirectory


def evaluate(
    directory: str | os.PathLike[str],
    *,
    episodes: int = 50,
    seed: int = 0,
    step: int | None = None,
    environment: str | None = None,
) -> Scores:
    """Play episodes with one checkpoint of every seed of a run; nothing in its directory changes.

    Args:
        directory: a run's directory.
        episodes: episodes for each seed.
        seed: chooses the starts, the same for every seed of the run.
        step: the checkpoint after so many updates; None takes each seed's last.
        environment: a gymnasium id; None takes the environment that the run was evaluated in, else its data set's.

    Raises:
        CheckpointError: there is no run, no such checkpoint, or a damaged one.
        ConfigError: no environment is known, or a number is out of range.
    """
    run = RunDirectory(Path(directory))
    settings = run.config.get("evaluate") or {}
    known = settings.get("environment") or run.data["environment"]
    if environment is None and known is None:
        raise ConfigError(
            f"{run.path}: neither the run nor its data set names an environment to play in; "
            "give one, as --env Hopper-v5"
        )
    rollouts = Rollouts(environment, episodes=episodes, seed=seed, max_steps=settings.get("max_steps")).resolved(known)
    assert isinstance(rollouts.environment, dict)
    make_env = make(rollouts.environment)
    summaries = {}
    for policy_seed in run.seeds:
        checkpoint = run.checkpoint(policy_seed, step)
        found = rollout(run.policy(policy_seed, checkpoint.step), make_env, episodes, seed, rollouts.max_steps)
        summaries[policy_seed] = {"evaluation": {"step": checkpoint.step, **summarise(found).summary}}
    return scores_from(summaries, str(run.path), rollouts.environment.get("id"))
