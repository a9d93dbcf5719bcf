"""Letting a policy act: many episodes side by side, one compiled policy call a step."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np

from odaf.environments.contact_margins import ContactMargins, check, simulator_of
from odaf.environments.start_seeds import EVALUATION_SEED_OFFSET, MOST_EPISODES
from odaf.errors import ConfigError
from odaf.training.evaluator import Evaluation
from odaf.training.files import write_arrays
from odaf.training.policy import Policy

# An environment that is still going after so many steps has no time limit.
_NO_LIMIT = 100_000


@runtime_checkable
class Environment(Protocol):
    """The part of gymnasium's interface that is used; any object with these methods will do."""

    def reset(self, *, seed: int | None = None) -> tuple[Any, dict[str, Any]]: ...

    def step(self, action: Any, /) -> tuple[Any, Any, bool, bool, dict[str, Any]]: ...

    def close(self) -> None: ...


MakeEnvironment = Callable[[], Environment]


@runtime_checkable
class Stepwise(Protocol):
    """A policy that is told when episodes begin and what they earn, such as `odaf.Policy`, so that it may remember."""

    def begin(self, rows: int, /) -> Any: ...

    def act(self, carry: Any, observations: np.ndarray, /) -> tuple[np.ndarray, Any]: ...

    def observe(self, carry: Any, rewards: np.ndarray, /) -> Any: ...


Acting = Callable[[np.ndarray], np.ndarray] | Stepwise


@dataclass(frozen=True)
class Episodes:
    """What happened in a number of episodes; NaN stands after an episode's end.

    Attributes:
        observations: [episodes, time + 1, obs_dim] float32, in the user's units, the last observation included.
        rewards: [episodes, time] float32.
        lengths: [episodes] int64, steps.
        returns: [episodes] float64, undiscounted sums of the rewards.
        flags: for each boolean in the info of every episode's last step (such as `success`): [episodes] bool.
    """

    observations: np.ndarray
    rewards: np.ndarray
    lengths: np.ndarray
    returns: np.ndarray
    flags: dict[str, np.ndarray]

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

    Raises:
        ConfigError: a number is out of range, or an environment goes on without end.
    """
    environments = [make_env() for _ in range(episodes)]
    try:
        return rollout_in(policy, environments, seed, max_steps)
    finally:
        for environment in environments:
            environment.close()


def rollout_in(
    policy: Acting,
    environments: Sequence[Environment],
    seed: int = 0,
    max_steps: int | None = None,
) -> Episodes:
    """`rollout` in environments that already exist; they are reset first and stay open."""
    episodes = len(environments)
    _check(episodes, seed, max_steps)
    first_seed = EVALUATION_SEED_OFFSET + seed * MOST_EPISODES
    starts = [environment.reset(seed=first_seed + index)[0] for index, environment in enumerate(environments)]
    current = np.stack([np.asarray(start, np.float32) for start in starts])
    observations, rewards = [current.copy()], []
    infos: list[dict[str, Any]] = [{} for _ in environments]
    running = np.ones(episodes, bool)
    lengths = np.zeros(episodes, np.int64)
    act, observe = _player(policy, episodes)
    while running.any():
        if max_steps is None and len(rewards) >= _NO_LIMIT:
            raise ConfigError(f"environment: still going after {_NO_LIMIT:,} steps; give max_steps to cut episodes")
        actions = act(current)
        seen = np.full_like(current, np.nan)
        earned = np.full(episodes, np.nan, np.float32)
        for index in np.flatnonzero(running).tolist():
            observation, reward, terminated, truncated, info = environments[index].step(actions[index])
            seen[index] = current[index] = observation
            earned[index] = reward
            infos[index] = info
            lengths[index] += 1
            running[index] = not (terminated or truncated or lengths[index] == max_steps)
        observations.append(seen)
        rewards.append(earned)
        observe(np.where(np.isnan(earned), np.float32(0.0), earned))
    table = np.stack(rewards, axis=1)
    return Episodes(
        observations=np.stack(observations, axis=1),
        rewards=table,
        lengths=lengths,
        returns=np.nansum(table.astype(np.float64), axis=1),
        flags=_flags(infos),
    )


def _player(policy: Acting, episodes: int) -> tuple[Callable[[np.ndarray], np.ndarray], Callable[[np.ndarray], object]]:
    """How to ask the policy for actions, and how to tell it rewards; the carry, if any, is kept in between."""
    if not isinstance(policy, Stepwise):
        return policy, lambda rewards: None
    carry = policy.begin(episodes)

    def act(observations: np.ndarray) -> np.ndarray:
        nonlocal carry
        actions, carry = policy.act(carry, observations)
        return actions

    def observe(rewards: np.ndarray) -> None:
        nonlocal carry
        carry = policy.observe(carry, rewards)

    return act, observe


def _flags(infos: Sequence[Mapping[str, Any]]) -> dict[str, np.ndarray]:
    names = [name for name, value in infos[0].items() if isinstance(value, bool | np.bool_)]
    return {
        name: np.array([info[name] for info in infos], bool)
        for name in names
        if all(isinstance(info.get(name), bool | np.bool_) for info in infos)
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
        environment: a gymnasium id, or a description for `odaf.environments.make`; None means the dataset's own.
        episodes: episodes in each evaluation.
        every: updates between two evaluations; the last update is always followed by one.
        seed: chooses starts; the same for every method and checkpoint, so that they can be compared in pairs.
        max_steps: cuts episodes that the environment does not end itself.
        contact_margins: how MuJoCo counts the margins of geoms that touch, "added" or "larger"; None leaves it to the
            environment's description, and it to the installed MuJoCo. See `odaf.environments.contact_margins`.
    """

    environment: str | Mapping[str, Any] | None = None
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
            environment = {"name": "gymnasium", "id": environment, "kwargs": {}}
        rule = {} if self.contact_margins is None else {"contact_margins": self.contact_margins}
        return replace(self, environment={**environment, **rule}, contact_margins=None)

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; `from_dict` restores an equal object."""
        environment = dict(self.environment) if isinstance(self.environment, Mapping) else self.environment
        return {
            "kind": "rollouts",
            "environment": environment,
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
    """Rollouts as the training loop wants them: environments are built once and reused at every evaluation."""

    def __init__(self, rollouts: Rollouts, make_env: MakeEnvironment):
        self.rollouts = rollouts
        self.every = rollouts.every
        self._make_env = make_env
        self._environments: list[Environment] = []

    def __call__(self, policy: Policy, directory: Path, step: int) -> Evaluation:
        """Rolls out, writes `directory/evaluations/STEP.npz`, and sums up."""
        if not self._environments:
            self._environments = [self._make_env() for _ in range(self.rollouts.episodes)]
        found = rollout_in(policy, self._environments, self.rollouts.seed, self.rollouts.max_steps)
        found.save(directory / "evaluations" / f"{step:08d}.npz")
        evaluation = summarise(found)
        simulator = simulator_of(self._environments[0], self.contact_margins)
        if simulator is None:
            return evaluation
        return replace(evaluation, summary={**evaluation.summary, "simulator": simulator})

    @property
    def contact_margins(self) -> ContactMargins | None:
        """The rule that the environment's description asks for."""
        environment = self.rollouts.environment
        return environment.get("contact_margins") if isinstance(environment, Mapping) else None

    def to_dict(self) -> dict[str, Any]:
        return self.rollouts.to_dict()

    def close(self) -> None:
        """Closes the environments; the next call builds new ones."""
        for environment in self._environments:
            environment.close()
        self._environments = []


def summarise(episodes: Episodes) -> Evaluation:
    """Mean and standard deviation (divisor N, over episodes) of the returns, and the share of each flag."""
    returns, rates = episodes.returns, {f"{name}_rate": float(flag.mean()) for name, flag in episodes.flags.items()}
    mean, std, count = float(returns.mean()), float(returns.std()), len(returns)
    metrics: dict[str, float | int] = {"evaluation/return_mean": mean, "evaluation/return_std": std}
    metrics |= {f"evaluation/{name}": rate for name, rate in rates.items()}
    metrics |= {"evaluation/length_mean": float(episodes.lengths.mean()), "evaluation/episodes": count}
    summary = {"mean_return": mean, "std_return": std, **rates, "episodes": count, "returns": returns.tolist()}
    return Evaluation(metrics, summary, headline=mean)
