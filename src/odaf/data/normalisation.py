"""Maps between the user's units and the learner's: observations to zero mean and unit scale, actions to [-1, 1]."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from odaf.errors import DatasetError

_PIECE = 65_536  # rows
Numbers = TypeVar("Numbers")  # a NumPy or a JAX array; what goes in decides what comes out


@dataclass(frozen=True, eq=False)
class Normaliser:
    """Shifts and scales observations: `(observation - mean) / (std + epsilon)`.

    Works on NumPy and JAX arrays of any leading shape alike, and imports neither's machinery beyond NumPy.

    Attributes:
        mean: [obs_dim] float32, in the user's units.
        std: [obs_dim] float32, the plain standard deviation (divisor N), without `epsilon`.
        epsilon: added to `std`, so that a constant column becomes zero and not infinite.
    """

    mean: np.ndarray
    std: np.ndarray
    epsilon: float = 1e-3

    def __post_init__(self):
        mean = np.array(self.mean, np.float32)
        std = np.array(self.std, np.float32)
        if mean.ndim != 1 or mean.shape != std.shape:
            raise DatasetError(f"normaliser: mean has shape {mean.shape}, std {std.shape}; both must be [obs_dim]")
        scale = std + np.float32(self.epsilon)
        if not (np.isfinite(mean).all() and np.isfinite(scale).all() and (scale > 0).all()):
            raise DatasetError(
                "normaliser: mean and std + epsilon must be finite and std + epsilon positive; "
                f"mean {mean.tolist()}, std {std.tolist()}, epsilon {self.epsilon}"
            )
        for name, value in (("mean", mean), ("std", std)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    @property
    def scale(self) -> np.ndarray:
        """What one learner's unit is in the user's: `std + epsilon`, [obs_dim] float32."""
        return self.std + np.float32(self.epsilon)

    @classmethod
    def fit(cls, observations: np.ndarray, epsilon: float = 1e-3) -> "Normaliser":
        """Mean and standard deviation of the rows of `observations` [rows, obs_dim], summed in double precision."""
        if np.ndim(observations) != 2 or len(observations) == 0:
            raise DatasetError(
                f"normaliser: observations must be [rows, obs_dim] with at least one row, got {np.shape(observations)}"
            )
        mean = np.asarray(np.mean(observations, axis=0, dtype=np.float64))
        squares = np.zeros(observations.shape[1])
        for first in range(0, len(observations), _PIECE):  # in pieces: a copy in double precision is twice the data
            squares += np.square(observations[first : first + _PIECE] - mean).sum(axis=0)
        return cls(mean=mean, std=np.sqrt(squares / len(observations)), epsilon=epsilon)

    @classmethod
    def identity(cls, obs_dim: int) -> "Normaliser":
        """Leaves observations as they are."""
        return cls(mean=np.zeros(obs_dim), std=np.ones(obs_dim), epsilon=0.0)

    def normalise(self, observations: Numbers) -> Numbers:
        """User's units to learner's; the last axis is `obs_dim`."""
        shifted = observations - _aligned(self.mean, observations)  # type: ignore
        shifted /= _aligned(self.scale, observations)  # in place where that is possible: the rows may be many
        return shifted

    def denormalise(self, observations: Numbers) -> Numbers:
        """Learner's units to the user's."""
        return observations * _aligned(self.scale, observations) + _aligned(self.mean, observations)  # type: ignore

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; `from_dict` restores the same bits."""
        return {"mean": self.mean.tolist(), "std": self.std.tolist(), "epsilon": self.epsilon}

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any]) -> "Normaliser":
        """Inverse of `to_dict`."""
        return cls(np.asarray(fields["mean"]), np.asarray(fields["std"]), float(fields["epsilon"]))


def scale_actions(actions: Numbers, low, high) -> Numbers:
    """User's units to [-1, 1]; bounds of exactly -1 and 1 change no bit. Inverse of `unscale_actions`."""
    centre, half = _centre_and_half(low, high)
    return (actions - _aligned(centre, actions)) / _aligned(half, actions)  # type: ignore


def unscale_actions(actions: Numbers, low, high) -> Numbers:
    """[-1, 1] to the user's units."""
    centre, half = _centre_and_half(low, high)
    return actions * _aligned(half, actions) + _aligned(centre, actions)  # type: ignore


def _centre_and_half(low, high) -> tuple[np.ndarray, np.ndarray]:
    low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
    return ((high + low) / 2).astype(np.float32), ((high - low) / 2).astype(np.float32)


def _aligned(vector: np.ndarray, like: Any) -> np.ndarray:
    # Leading axes of size one: JAX may be told to refuse adding a vector to a matrix.
    return vector.reshape((1,) * (np.ndim(like) - 1) + (-1,))
