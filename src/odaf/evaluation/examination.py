"""Whether policies of these data can be tried in this environment: found out in a moment, before anything is trained.

The environment is made twice, reset with one seed, and stepped once with one action. What cannot work is refused with
the remedy; what works but cannot be repeated is named.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from odaf.data.derived import Derivation
from odaf.data.spec import Spec
from odaf.environments.contact_margins import ContactMargins, simulator_of
from odaf.environments.robotics_ant_maze import ORDERS, is_one, reading_of_scores
from odaf.environments.start_seeds import EVALUATION_SEED_OFFSET
from odaf.errors import ConfigError
from odaf.training.policy import Policy

_WITHOUT = "or leave the evaluation out (--evaluate-every 0; evaluate=None in Python)"
_WRAP = (
    "wrap it so that it returns one array in the order of the data's columns, and give the wrapped environment: "
    "evaluate=odaf.Rollouts(make_env) in Python, or register it and give --env MODULE:ID"
)


@dataclass(frozen=True)
class Examined:
    """An environment in which policies of the data can be tried.

    Attributes:
        make_env: builds it, with its observations as one array in the order of the data's columns.
        ignores_seed: what differs between two resets or steps with one seed, in words; empty where nothing does.
        simulator: what plays it, as `odaf.environments.contact_margins.simulator_of` says.
        derivation: by which policies compute the data's observations from what it gives; None where it gives these.
        reading: what must be known to read its scores; empty where they say what they seem to.
    """

    make_env: Callable[[], Any]
    ignores_seed: str
    simulator: dict[str, Any] | None
    derivation: Derivation | None = None
    reading: str = ""

    def fitting(self, policy: Policy) -> Policy:
        """The policy as it takes what the environment gives."""
        return policy if self.derivation is not None else policy.without_derivation()

    @property
    def warnings(self) -> dict[str, str]:
        """Sentences for the user about what does not go by itself, by kind."""
        found = {"reading-of-scores": self.reading} if self.reading else {}
        if self.derivation is not None and self.derivation.history:
            found["first-steps"] = (
                f"observations are made of {self.derivation.history} earlier steps, which the first of an episode have "
                "not: in these the middle of the action bounds is played, and their rewards count"
            )
        if not self.ignores_seed:
            return found
        return found | {
            "unseeded-environment": f"{self.ignores_seed} in two trials with one seed: the environment ignores its "
            "seed, so two evaluations of one policy differ, and so do the starts of two policies that are compared"
        }


def examine(
    make_env: Callable[[], Any],
    name: str,
    spec: Spec,
    observation_names: Sequence[str],
    rule: ContactMargins | None = None,
    derivation: Derivation | None = None,
) -> Examined:
    """Tries an environment for one step.

    Args:
        make_env: builds it; anything with gymnasium's `reset(seed=...)`, `step(action)` and `close()`.
        name: what messages call it.
        spec: sizes and action bounds of the data.
        observation_names: the data's columns, in their order.
        rule: how it was made to count contact margins, for the record.
        derivation: how the data's observations were computed from readings, if they were. An environment that gives as
            many numbers as there are readings, or a dictionary with their names, gives readings.

    Raises:
        ConfigError: it cannot be made, reset or stepped, or does not fit the data.
    """
    readings = () if derivation is None else derivation.readings
    first = _attempt(name, "cannot be made", make_env)
    try:
        simulator = simulator_of(first, rule)
        _check_actions(first, name, spec)
        action = _middle(spec)
        keys, start, on_readings = _start(first, name, spec, observation_names, derivation)
        environment = first if keys is None else JoinedObservations(first, keys)
        step = _step(environment, name, action, spec)
        second = _attempt(name, "cannot be made twice", make_env)
        other = second if keys is None else JoinedObservations(second, keys)
        try:
            ignores = _differs(environment, other, name, action, spec, start, step, readings)
        finally:
            second.close()
    finally:
        first.close()
    applied, reading = derivation if on_readings else None, reading_of_scores(_identity(first))
    if keys is None:
        return Examined(make_env, ignores, simulator, applied, reading)
    return Examined(lambda: JoinedObservations(make_env(), keys), ignores, simulator, applied, reading)


class JoinedObservations:
    """An environment whose observations, a dictionary, come as one array; everything else is the environment's own.

    Args:
        environment: what is wrapped.
        keys: entries to join, in this order; `a/b` is entry b of entry a.
    """

    def __init__(self, environment: Any, keys: Sequence[str]):
        self.environment, self._keys = environment, tuple(keys)

    def reset(self, *, seed: int | None = None) -> tuple[np.ndarray, dict[str, Any]]:
        observation, info = self.environment.reset(seed=seed)
        return self._joined(observation), info

    def step(self, action: Any) -> tuple[np.ndarray, Any, bool, bool, dict[str, Any]]:
        observation, *rest = self.environment.step(action)
        return self._joined(observation), *rest

    def close(self) -> None:
        self.environment.close()

    def __getattr__(self, name: str) -> Any:
        return getattr(self.environment, name)

    def _joined(self, observation: Any) -> np.ndarray:
        leaves = _leaves(observation)
        return np.concatenate([leaves[key] for key in self._keys])


def reward_of(reward: Any) -> float:
    """A reward as a number, also where it comes as an array of one.

    Raises:
        ConfigError: it is something else.
    """
    if isinstance(reward, float):
        return reward
    try:
        (value,) = np.asarray(reward, np.float64).reshape(-1)
    except (TypeError, ValueError):
        raise ConfigError(f"reward: expected one number, the environment's step gave {reward!r}") from None
    return float(value)


def _attempt(name: str, what: str, action: Callable[[], Any]) -> Any:
    try:
        return action()
    except ConfigError:
        raise
    except Exception as error:  # an environment of somebody else's fails in ways of its own
        raise ConfigError(
            f"environment {name}: {what} ({type(error).__name__}: {error}); mend it or name another, {_WITHOUT}"
        ) from error


def _check_actions(environment: Any, name: str, spec: Spec) -> None:
    space = getattr(environment, "action_space", None)
    if space is None:
        return
    shape = getattr(space, "shape", None)
    if type(space).__name__ != "Box" or shape is None:
        raise ConfigError(
            f"environment {name}: its actions are {space}, but the data's are {spec.act_dim} numbers between bounds; "
            f"give an environment with continuous actions, {_WITHOUT}"
        )
    if tuple(shape) != (spec.act_dim,):
        raise ConfigError(
            f"environment {name}: its actions have shape {tuple(shape)}, the data's {(spec.act_dim,)}; it is not the "
            f"environment of these data: name another with --env, {_WITHOUT}"
        )


def _middle(spec: Spec) -> np.ndarray:
    """An action well inside the bounds, and different in each dimension, so that it does something."""
    low, high = np.asarray(spec.action_low, np.float32), np.asarray(spec.action_high, np.float32)
    return low + (high - low) * np.linspace(0.6, 0.7, spec.act_dim, dtype=np.float32)


def _start(
    environment: Any, name: str, spec: Spec, observation_names: Sequence[str], derivation: Derivation | None
) -> tuple[tuple[str, ...] | None, np.ndarray, bool]:
    """The keys to join where observations are dictionaries, the first observation, and whether it holds readings."""
    result = _attempt(name, "its reset(seed=...) fails", lambda: environment.reset(seed=EVALUATION_SEED_OFFSET))
    if not isinstance(result, tuple) or len(result) != 2:
        raise ConfigError(
            f"environment {name}: its reset gives {type(result).__name__}, not (observation, info); it has the "
            "interface of old gym: wrap it for gymnasium (gymnasium.make('GymV21Environment-v0', env=...)), " + _WITHOUT
        )
    observation, readings = result[0], () if derivation is None else derivation.readings
    if not isinstance(observation, Mapping):
        vector = _vector(observation, name, spec, readings)
        return None, vector, len(vector) == len(readings)
    leaves = _leaves(observation)
    for names in (readings, observation_names):
        keys = _order(leaves, names) if names else None
        if keys is not None:
            joined = np.concatenate([leaves[key] for key in keys])
            return keys, _vector(joined, name, spec, readings), names is readings
    for keys in ORDERS if is_one(_identity(environment)) else ():
        if sum(leaves[key].size for key in keys) == spec.obs_dim:
            return keys, _vector(np.concatenate([leaves[key] for key in keys]), name, spec, readings), False
    parts = ", ".join(f"{key} [{part.size}]" for key, part in leaves.items())
    of = "" if derivation is None else f" nor do its readings ({', '.join(readings)})"
    raise ConfigError(
        f"environment {name}: observations are dictionaries of {parts}, and the data's {spec.obs_dim} columns "
        f"({', '.join(observation_names[:4])}{', ...' if len(observation_names) > 4 else ''}) do not say which is "
        f"which{of}; name the data's columns after these entries (goal_0, goal_1, ...), or {_WRAP}, {_WITHOUT}"
    )


def _identity(environment: Any) -> str | None:
    """Gymnasium's id of an environment; None where it has none."""
    return getattr(getattr(environment, "spec", None), "id", None)


def _leaves(observation: Mapping[str, Any], before: str = "") -> dict[str, np.ndarray]:
    found: dict[str, np.ndarray] = {}
    for key, value in observation.items():
        path = f"{before}{key}"
        found |= _leaves(value, f"{path}/") if isinstance(value, Mapping) else {path: np.ravel(np.asarray(value))}
    return found


def _order(leaves: Mapping[str, np.ndarray], names: Sequence[str]) -> tuple[str, ...] | None:
    """The entries in the order of the data's columns; None where the columns' names do not tell it."""
    keys: list[str] = []
    place = 0
    while place < len(names):
        fitting = [
            key
            for key, part in leaves.items()
            if key not in keys and _named_after(key, part.size, names[place : place + part.size])
        ]
        if len(fitting) != 1:
            return None
        keys.append(fitting[0])
        place += leaves[fitting[0]].size
    return tuple(keys)


def _named_after(key: str, width: int, names: Sequence[str]) -> bool:
    if width == 1 and list(names) == [key]:
        return True
    numbers = [re.fullmatch(rf"{re.escape(key)}[_./\[ -]?(\d+)\]?", name) for name in names]
    found = [int(number.group(1)) for number in numbers if number is not None]
    return width > 0 and len(found) == width and found in (list(range(width)), list(range(1, width + 1)))


def _vector(observation: Any, name: str, spec: Spec, readings: Sequence[str] = ()) -> np.ndarray:
    try:
        vector = np.asarray(observation, np.float32)
    except (TypeError, ValueError):
        raise ConfigError(
            f"environment {name}: its observation is a {type(observation).__name__}, not one array of numbers; {_WRAP}"
        ) from None
    if vector.shape != (spec.obs_dim,) and (not readings or vector.shape != (len(readings),)):
        raw = f", their {len(readings)} readings' {(len(readings),)} ({', '.join(readings)})" if readings else ""
        raise ConfigError(
            f"environment {name}: its observations have shape {vector.shape}, the data's {(spec.obs_dim,)}{raw}; it is "
            f"not the environment of these data: name another with --env, {_WITHOUT}"
        )
    if not np.isfinite(vector).all():
        column = int(np.argmin(np.isfinite(vector)))
        raise ConfigError(f"environment {name}: observation {column} is not finite after reset; mend the environment")
    return vector


def _step(environment: Any, name: str, action: np.ndarray, spec: Spec) -> tuple[np.ndarray, float]:
    result = _attempt(name, "its step fails", lambda: environment.step(action.copy()))
    if not isinstance(result, tuple) or len(result) != 5:
        raise ConfigError(
            f"environment {name}: its step gives {len(result) if isinstance(result, tuple) else type(result).__name__} "
            "results, not (observation, reward, terminated, truncated, info); wrap it for gymnasium, " + _WITHOUT
        )
    return np.asarray(result[0], np.float32), reward_of(result[1])


def _differs(
    environment: Any,
    other: Any,
    name: str,
    action: np.ndarray,
    spec: Spec,
    start: np.ndarray,
    step: tuple[np.ndarray, float],
    readings: Sequence[str],
) -> str:
    for again in (environment, other):
        observation = _attempt(name, "its second reset fails", lambda env=again: env.reset(seed=EVALUATION_SEED_OFFSET))
        if not np.array_equal(_vector(observation[0], name, spec, readings), start):
            return f"{name}: the first observations differ"
        then = _step(again, name, action, spec)
        if not np.array_equal(then[0], step[0], equal_nan=True):
            return f"{name}: the observations after one step differ"
        if not np.array_equal(then[1], step[1], equal_nan=True):
            return f"{name}: the rewards of one step differ"
    return ""
