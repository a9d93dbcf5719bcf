"""Episodes of a run's policies played side by side, each process on its share of the cores."""

import functools
import itertools
import pickle
from dataclasses import dataclass, replace

import jax

from odaf.errors import ConfigError
from odaf.evaluation.parts import in_one
from odaf.evaluation.rollouts import Episodes, rollout
from odaf.runs.fresh_process import Surroundings
from odaf.runs.trial import Trial
from odaf.runs.workers import run_jobs


@dataclass(frozen=True)
class Part:
    """Some episodes of one policy.

    Attributes:
        policy_seed: whose.
        first: number of the first.
        episodes: how many.
    """

    policy_seed: int
    first: int
    episodes: int


def parts_of(seeds: int, episodes: int, workers: int) -> list[tuple[int, int]]:
    """(first, count) of the parts that the episodes of each policy are played in: as few as keep all workers busy."""
    parts = min(episodes, max(1, -(-workers // seeds)))
    borders = [episodes * number // parts for number in range(parts + 1)]
    return [(first, after - first) for first, after in itertools.pairwise(borders)]


def played_apart(trial: Trial, workers: int) -> dict[int, Episodes]:
    """The episodes of every seed's policy, as `rollout` gives them; the processes leave an accelerator alone.

    Raises:
        ConfigError: the environment cannot be sent to another process.
    """
    # What the other processes build themselves is left out.
    trial = replace(trial)
    try:
        pickle.dumps(trial)
    except Exception as error:  # pickling fails in as many ways as there are objects
        raise ConfigError(
            f"evaluate: {trial.rollouts.name} cannot be sent to another process ({error}); play with workers=1"
        ) from None
    seeds = trial.run.seeds
    cuts = parts_of(len(seeds), trial.rollouts.episodes, workers)
    parts = [Part(seed, first, count) for seed in seeds for first, count in cuts]
    prepare = functools.partial(_prepare, trial, Surroundings.of(trial.run.algorithm))
    played = dict(run_jobs(_play, parts, min(workers, len(parts)), prepare=prepare, always_apart=True))
    return {seed: in_one([played[part] for part in parts if part.policy_seed == seed]) for seed in seeds}


_trial: Trial


def _prepare(trial: Trial, surroundings: Surroundings) -> None:
    global _trial
    surroundings.settle()
    jax.config.update("jax_platforms", "cpu")
    _trial = trial


def _play(part: Part) -> Episodes:
    with _trial.precision():
        return rollout(
            _trial.policy(part.policy_seed),
            _trial.examined.make_env,
            part.episodes,
            _trial.rollouts.seed,
            _trial.rollouts.max_steps,
            part.first,
        )
