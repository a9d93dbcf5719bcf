"""What a learner must know about a task before it sees a single row; no array library is loaded here."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Spec:
    """Sizes, action bounds and reward range of a dataset: hashable, so it can be a static argument of compiled code.

    Attributes:
        obs_dim: numbers in one observation.
        act_dim: numbers in one action.
        action_low: smallest action in the user's units, one entry per action dimension.
        action_high: largest action in the user's units; a learner's -1 and +1 map to `action_low` and `action_high`.
        reward_min: smallest logged reward. With `reward_max` it bounds every value a critic can rightly claim.
        reward_max: largest logged reward.
        ever_terminates: whether any logged row is a true end of the task (not a time limit).
        max_episode_length: steps in the longest logged episode.
    """

    obs_dim: int
    act_dim: int
    action_low: tuple[float, ...]
    action_high: tuple[float, ...]
    reward_min: float
    reward_max: float
    ever_terminates: bool
    max_episode_length: int

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; `from_dict` restores an equal `Spec`."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any]) -> "Spec":
        """Inverse of `to_dict`."""
        return cls(
            obs_dim=int(fields["obs_dim"]),
            act_dim=int(fields["act_dim"]),
            action_low=tuple(float(value) for value in fields["action_low"]),
            action_high=tuple(float(value) for value in fields["action_high"]),
            reward_min=float(fields["reward_min"]),
            reward_max=float(fields["reward_max"]),
            ever_terminates=bool(fields["ever_terminates"]),
            max_episode_length=int(fields["max_episode_length"]),
        )
