"""Letting a policy act: many episodes side by side, one compiled policy call a step.

A number that is not finite, be it a reward, an observation or an action, ends its episode and marks it: what such an
episode would have earned is not known, so its return is NaN, and no mean counts it.
"""

import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from odaf.environments.contact_margins import ContactMargins, apply, check
from odaf.environments.registry import make
from odaf.environments.robotics_ant_maze import evaluation_settings
from odaf.environments.start_seeds import EVALUATION_SEED_OFFSET, MOST_EPISODES
from odaf.errors import ConfigError, OdafError
from odaf.evaluation.examination import reward_of
from odaf.evaluation.player import Acting, Player
from odaf.training.evaluator import Evaluation
from odaf.training.files import write_arrays
from odaf.training.policy import Policy

# An environment that is still going after so many steps has no time limit.
_NO_LIMIT = 100_000
# Name of an environment that a class or function of the user's builds, in records.
CALLABLE = "callable"


@runtime_checkable
class Environment(Protocol):
    """The part of gymnasium's interface that is used; any object with these methods will do."""

    def reset(self, *, seed: int | None = None) -> tuple[Any, dict[str, Any]]: ...

    def step(self, action: Any, /) -> tuple[Any, Any, bool, bool, dict[str, Any]]: ...

    def close(self) -> None: ...


MakeEnvironment = Callable[[], Environment]


@dataclass(frozen=True)
class Episodes:
    """What happened in a number of episodes; NaN stands after an episode's end.

    Attributes:
        observations: [episodes, time + 1, obs_dim] float32, in the user's units, the last observation included.
        rewards: [episodes, time] float32.
        lengths: [episodes] int64, steps.
        returns: [episodes] float64, undiscounted sums of the rewards; NaN for a broken episode.
        broken: what was not a finite number, and when, for each episode that ended so; by the episode's number.
        flags: for each boolean in the info of every episode's last step (such as `success`): [episodes] bool.
    """

    observations: np.ndarray
    rewards: np.ndarray
    lengths: np.ndarray
    returns: np.ndarray
    flags: dict[str, np.ndarray]
    broken: dict[int, str] = field(default_factory=dict)

    def save(self, path: Path) -> None:
        """Writes all arrays to one .npz file, flags under their own names, atomically."""
        path.parent.mkdir(parents=True, exist_ok=True)
        arrays = {
            "observations": self.observations,
            "rewards": self.rewards,
            "lengths": self.lengths,
            "returns": self.returns,
            **self.flags,
        }
        write_arrays(path, arrays)


def rollout(
    policy: Acting,
    make_env: MakeEnvironment,
    episodes: int,
    seed: int = 0,
    max_steps: int | None = None,
    first: int = 0,
) -> Episodes:
    """Runs exactly one episode in each of `episodes` fresh environments, all in step with one another.

    Each environment stands still once its episode has ended, so short episodes do not count more often than long ones.

    Args:
        policy: maps observations [episodes, obs_dim] to actions [episodes, act_dim], or does so with a memory; always
            called with all rows, those of ended episodes included, so that it is compiled once. Rewards of ended
            episodes count as 0 for the memory.
        make_env: builds an environment.
        episodes: how many.
        seed: chooses the environments' reset seeds; equal seeds give equal starts, for a fair comparison of policies.
        max_steps: cuts episodes that the environment does not end itself.
        first: number of the first episode, which has the start of that number; for an evaluation played in parts.

    Raises:
        ConfigError: a number is out of range, or an environment goes on without end.
    """
    environments = [make_env() for _ in range(episodes)]
    try:
        return rollout_in(policy, environments, seed, max_steps, first)
    finally:
        for environment in environments:
            environment.close()


def rollout_in(
    policy: Acting,
    environments: Sequence[Environment],
    seed: int = 0,
    max_steps: int | None = None,
    first: int = 0,
) -> Episodes:
    """`rollout` in environments that already exist; they are reset first and stay open."""
    episodes = len(environments)
    _check(first + episodes, seed, max_steps)
    first_seed = EVALUATION_SEED_OFFSET + seed * MOST_EPISODES + first
    starts = [environment.reset(seed=first_seed + index)[0] for index, environment in enumerate(environments)]
    current = np.stack([np.asarray(start, np.float32) for start in starts])
    broken: dict[int, str] = {}
    for index in np.flatnonzero(~np.isfinite(current).all(axis=1)).tolist():
        broken[index] = "an observation is not finite at the start"
        current[index] = 0.0
    observations, rewards = [current.copy()], []
    infos: list[dict[str, Any]] = [{} for _ in environments]
    running = np.array([index not in broken for index in range(episodes)])
    lengths = np.zeros(episodes, np.int64)
    player = Player(policy, episodes)
    while running.any():
        if max_steps is None and len(rewards) >= _NO_LIMIT:
            raise ConfigError(f"environment: still going after {_NO_LIMIT:,} steps; give max_steps to cut episodes")
        actions = player.act(current, running)
        observed, paid = np.full(current.shape, np.nan), np.full(episodes, np.nan)
        for index in np.flatnonzero(running & ~np.isfinite(actions).all(axis=1)).tolist():
            # A simulator may play it as zero, and nobody would know.
            broken[index], running[index] = f"an action is not finite at step {lengths[index] + 1}", False
        played = np.flatnonzero(running)
        for index in played.tolist():
            # A copy, since some environments write into the action they are given.
            observation, reward, terminated, truncated, info = environments[index].step(actions[index].copy())
            lengths[index] += 1
            observed[index], paid[index], infos[index] = observation, reward_of(reward), info
            running[index] = not (terminated or truncated or lengths[index] == max_steps)
        with np.errstate(over="ignore"):  # a number beyond single precision counts as not finite
            seen, earned = observed.astype(np.float32), paid.astype(np.float32)
        sound = np.asarray(np.isfinite(seen[played]).all(axis=1))
        void = ~(sound & np.isfinite(earned[played]))
        current[played[sound]] = seen[played[sound]]
        for index, is_seen in zip(played[void].tolist(), sound[void].tolist(), strict=True):
            what = "a reward" if is_seen else "an observation"
            broken[index], running[index] = f"{what} is not finite at step {lengths[index]}", False
        observations.append(seen)
        rewards.append(earned)
        player.observe(np.where(np.isfinite(earned), earned, np.float32(0.0)))
    table = np.stack(rewards, axis=1) if rewards else np.zeros((episodes, 0), np.float32)
    returns = np.nansum(table.astype(np.float64), axis=1)
    returns[list(broken)] = np.nan
    return Episodes(np.stack(observations, axis=1), table, lengths, returns, _flags(infos, broken), broken)


def _flags(infos: Sequence[Mapping[str, Any]], broken: Mapping[int, str]) -> dict[str, np.ndarray]:
    """The booleans that every sound episode ends with; a broken one that does not tell counts as False."""
    sound = [info for index, info in enumerate(infos) if index not in broken]
    names = [name for name, value in (sound or [{}])[0].items() if isinstance(value, bool | np.bool_)]
    return {
        name: np.array([bool(info.get(name, False)) for info in infos], bool)
        for name in names
        if all(isinstance(info.get(name), bool | np.bool_) for info in sound)
    }


def _check(episodes: int, seed: int, max_steps: int | None) -> None:
    if not 1 <= episodes <= MOST_EPISODES:
        raise ConfigError(f"episodes: must be from 1 to {MOST_EPISODES}, got {episodes}")
    if not 0 <= seed < 10_000:
        raise ConfigError(f"evaluation seed: must be from 0 to 9999, got {seed}")
    if max_steps is not None and max_steps < 1:
        raise ConfigError(f"max_steps: must be at least 1, got {max_steps}")


@dataclass(frozen=True)
class Rollouts:
    """How a run is to be evaluated while it trains.

    Attributes:
        environment: a gymnasium id (`MODULE:ID` imports the module that registers it first), a description for
            `odaf.environments.make`, or a class or function without arguments that builds one; None means the
            dataset's own. A run that is gone on with in another process must be given its class or function again.
        episodes: episodes in each evaluation.
        every: updates between two evaluations; the last update is always followed by one.
        seed: chooses starts; the same for every method and checkpoint, so that they can be compared in pairs.
        max_steps: cuts episodes that the environment does not end itself.
        contact_margins: how MuJoCo counts the margins of geoms that touch, "added" or "larger"; None leaves it to the
            environment's description, and it to the installed MuJoCo. See `odaf.environments.contact_margins`.
    """

    environment: str | Mapping[str, Any] | MakeEnvironment | None = None
    episodes: int = 50
    every: int = 5000
    seed: int = 0
    max_steps: int | None = None
    contact_margins: ContactMargins | None = None

    def __post_init__(self):
        check(self.contact_margins)
        _check(self.episodes, self.seed, self.max_steps)
        if self.every < 1:
            raise ConfigError(f"every: must be at least 1, got {self.every}")

    def resolved(self, own: Mapping[str, Any] | None) -> "Rollouts":
        """The same with a full description of the environment; `own` is the dataset's.

        Raises:
            ConfigError: neither names one.
        """
        environment = own if self.environment is None else self.environment
        if environment is None:
            raise ConfigError(
                "evaluate: the dataset names no environment; give one, as Rollouts('Hopper-v5') or --env Hopper-v5, "
                "or train without evaluation"
            )
        if isinstance(environment, str):
            environment = {"name": "gymnasium", "id": environment, "kwargs": {**evaluation_settings(environment)}}
        if not isinstance(environment, Mapping):
            return replace(self, environment=environment)
        rule = {} if self.contact_margins is None else {"contact_margins": self.contact_margins}
        return replace(self, environment={**environment, **rule}, contact_margins=None)

    @property
    def rule(self) -> ContactMargins | None:
        """How contact margins are to be counted, once the environment is resolved; None: as the simulator does."""
        environment = self.environment
        return environment.get("contact_margins") if isinstance(environment, Mapping) else self.contact_margins

    @property
    def name(self) -> str:
        """What messages call the environment."""
        return name_of(self.environment)

    def maker(self) -> MakeEnvironment:
        """What builds the environment, once it is resolved.

        Raises:
            ConfigError: it is not known, or not installed.
        """
        environment = self.environment
        if isinstance(environment, Mapping):
            if environment.get("name") == CALLABLE:
                raise ConfigError(
                    f"environment: the run was evaluated in what {environment.get('made_by')} builds; give that class "
                    "or function again, as odaf.Rollouts(MyEnvironment), or name another environment with --env"
                )
            return make(environment)
        if callable(environment):
            return partial(_counting, environment, self.contact_margins, self.name)
        raise ConfigError(f"environment: {environment!r} is not resolved")  # a mistake of ours, not the user's

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; `from_dict` restores an equal object."""
        return {
            "kind": "rollouts",
            "environment": described(self.environment),
            "episodes": self.episodes,
            "every": self.every,
            "seed": self.seed,
            "max_steps": self.max_steps,
            **({} if self.contact_margins is None else {"contact_margins": self.contact_margins}),
        }

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any]) -> "Rollouts":
        """Inverse of `to_dict`."""
        if fields.get("kind") != "rollouts":
            raise ConfigError(f"evaluate: kind: expected 'rollouts', found {fields.get('kind')!r}")
        return cls(**{name: value for name, value in fields.items() if name != "kind"})


class RolloutEvaluator:
    """Rollouts as the training loop wants them: environments are built once and reused at every evaluation.

    Args:
        rollouts: the settings, resolved.
        make_env: builds an environment.
        warnings: what the user must know about the environment, a sentence a kind.
        simulator: what plays it, as `odaf.environments.contact_margins.simulator_of` says.
        fitting: makes a policy take what the environment gives.
    """

    def __init__(
        self,
        rollouts: Rollouts,
        make_env: MakeEnvironment,
        warnings: Mapping[str, str] | None = None,
        simulator: dict[str, Any] | None = None,
        fitting: Callable[[Policy], Policy] = lambda policy: policy,
    ):
        self.rollouts, self.simulator = rollouts, simulator
        self.every = rollouts.every
        self._make_env, self._warnings, self._fitting = make_env, dict(warnings or {}), fitting
        self._environments: list[Environment] = []

    def __call__(self, policy: Policy, directory: Path, step: int) -> Evaluation:
        """Rolls out, writes `directory/evaluations/STEP.npz`, and sums up.

        Raises:
            ConfigError: the environment failed; what was trained is saved.
        """
        try:
            if not self._environments:
                self._environments = [self._make_env() for _ in range(self.rollouts.episodes)]
            found = rollout_in(self._fitting(policy), self._environments, self.rollouts.seed, self.rollouts.max_steps)
        except OdafError:
            raise
        except Exception as error:  # an environment of somebody else's fails in ways of its own
            run = shlex.quote(str(directory.parent))
            raise ConfigError(
                f"environment {self.rollouts.name}: failed in the evaluation after update {step:,} "
                f"({type(error).__name__}: {error}). What was trained until then is saved in {directory}; mend the "
                f"environment and `odaf resume {run}`, or go on without it: `odaf resume {run} --no-evaluation`"
            ) from error
        found.save(directory / "evaluations" / f"{step:08d}.npz")
        evaluation = summarise(found)
        evaluation = replace(evaluation, warnings={**self._warnings, **evaluation.warnings})
        if self.simulator is None:
            return evaluation
        return replace(evaluation, summary={**evaluation.summary, "simulator": self.simulator})

    def to_dict(self) -> dict[str, Any]:
        return self.rollouts.to_dict()

    def close(self) -> None:
        """Closes the environments; the next call builds new ones."""
        for environment in self._environments:
            environment.close()
        self._environments = []


def summarise(episodes: Episodes) -> Evaluation:
    """Mean and standard deviation (divisor N) of the returns of the sound episodes, and the share of each flag.

    Broken episodes are counted and named; where all are broken, mean and deviation are NaN.
    """
    sound = episodes.returns[np.isfinite(episodes.returns)]
    rates = {f"{name}_rate": float(flag.mean()) for name, flag in episodes.flags.items()}
    mean, std = (float(sound.mean()), float(sound.std())) if sound.size else (math.nan, math.nan)
    count, broken = len(episodes.returns), len(episodes.broken)
    metrics: dict[str, float | int] = {"evaluation/return_mean": mean, "evaluation/return_std": std}
    metrics |= {f"evaluation/{name}": rate for name, rate in rates.items()}
    metrics |= {"evaluation/length_mean": float(episodes.lengths.mean()), "evaluation/episodes": count}
    summary = {"mean_return": mean, "std_return": std, **rates, "episodes": count}
    summary["returns"] = episodes.returns.tolist()
    warnings = {}
    if broken:
        metrics["evaluation/broken_episodes"] = summary["broken_episodes"] = broken
        index, what = next(iter(episodes.broken.items()))
        warnings["broken-episodes"] = (
            f"{broken} of {count} episodes broke off on a number that is not finite and are left out of the mean; the "
            f"first is episode {index}: {what}"
        )
    return Evaluation(metrics, summary, headline=mean, warnings=warnings)


def _counting(build: MakeEnvironment, rule: ContactMargins | None, name: str) -> Environment:
    environment = build()
    apply(environment, rule, name)
    return environment


def described(environment: Any) -> Any:
    """An environment as plain JSON types, for a record."""
    if environment is None or isinstance(environment, str):
        return environment
    if isinstance(environment, Mapping):
        return dict(environment)
    return {"name": CALLABLE, "made_by": name_of(environment)}


def name_of(environment: Any) -> str:
    """What messages call an environment."""
    if isinstance(environment, Mapping):
        return str(environment.get("id") or environment.get("made_by") or environment.get("name"))
    if isinstance(environment, str) or environment is None:
        return str(environment)
    kind = environment if hasattr(environment, "__qualname__") else type(environment)
    return f"{kind.__module__}.{kind.__qualname__}"
