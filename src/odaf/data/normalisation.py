"""Maps between the user's units and the learner's: observations to zero mean and unit scale, actions to [-1, 1]."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np

from odaf.errors import ConfigError, DatasetError

_PIECE = 65_536  # rows
_ROUNDING = 2.0**-24  # half a unit in the last place of single precision, relative
Numbers = TypeVar("Numbers")  # a NumPy or a JAX array; what goes in decides what comes out


@dataclass(frozen=True, eq=False)
class Normaliser:
    """Shifts and scales observations: `(observation - mean) / (std + epsilon)`, and 0 in columns that never varied.

    The unit of a column does not matter: rows in amperes and in nanoamperes are the same to a learner, unless it asks
    for an `epsilon`, which is in the unit of each column.

    Nothing can be learned from a column that never varied, so the learner never sees it change either: whatever such a
    sensor shows later reads as the logged value. Dividing by a small number instead would turn its first
    change into an input of thousands that no weight was trained on.

    Works on NumPy and JAX arrays of any leading shape alike, and imports neither's machinery beyond NumPy.

    Attributes:
        mean: [obs_dim] float32, in the user's units.
        std: [obs_dim] float32, the plain standard deviation (divisor N), without `epsilon`.
        epsilon: added to `std`, in the user's units; many papers add 1e-3.
        constant: the columns that never varied, by number.
        applied: whether observations are shifted and scaled by these; if not, only constant columns read as 0.
    """

    mean: np.ndarray
    std: np.ndarray
    epsilon: float = 0.0
    constant: tuple[int, ...] = ()
    applied: bool = True

    def __post_init__(self):
        mean = np.array(self.mean, np.float32)
        std = np.array(self.std, np.float32)
        if mean.ndim != 1 or mean.shape != std.shape:
            raise DatasetError(f"normaliser: mean has shape {mean.shape}, std {std.shape}; both must be [obs_dim]")
        if any(column not in range(len(std)) for column in self.constant):
            raise DatasetError(f"normaliser: constant columns {self.constant} are not all among {len(std)}")
        scale = std + np.float32(self.epsilon)
        moving = np.delete(scale, self.constant)
        if not (np.isfinite(mean).all() and np.isfinite(scale).all() and (moving > 0).all()):
            raise DatasetError(
                "normaliser: mean and std + epsilon must be finite, and std + epsilon positive where a column varies; "
                f"mean {mean.tolist()}, std {std.tolist()}, epsilon {self.epsilon}"
            )
        for name, value in (("mean", mean), ("std", std)):
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    @property
    def shift(self) -> np.ndarray:
        """[obs_dim] float32, what a learner's 0 is in the user's units: `mean`, or 0 where none is applied; in constant
        columns always their value."""
        shift = self.mean if self.applied else np.zeros_like(self.mean)
        shift = shift.copy()
        shift[list(self.constant)] = self.mean[list(self.constant)]
        return shift

    @property
    def scale(self) -> np.ndarray:
        """[obs_dim] float32, what a learner's unit is in the user's: `std + epsilon`, or 1 where none is applied;
        infinite in constant columns."""
        return self._scale(np.inf)

    def _scale(self, of_constants: float) -> np.ndarray:
        scale = self.std + np.float32(self.epsilon) if self.applied else np.ones_like(self.std)
        scale[list(self.constant)] = of_constants
        return scale

    @classmethod
    def fit(cls, observations: np.ndarray, epsilon: float = 0.0, applied: bool = True) -> "Normaliser":
        """Mean and standard deviation of the rows of `observations` [rows, obs_dim], summed in double precision.

        A column counts as constant if its standard deviation is no larger than what rounding to single precision can
        make of one value: half a unit in the last place, 2^-24 of the largest absolute value. So 1e9 with noise of 10,
        which single precision cannot hold, is a constant, and 1e-9 with noise of 1e-10 is not.

        Args:
            observations: the rows, in the user's units.
            epsilon: added to the standard deviations, in the user's units.
            applied: False measures both and leaves observations as they are, but for constant columns.
        """
        if np.ndim(observations) != 2 or len(observations) == 0:
            raise DatasetError(
                f"normaliser: observations must be [rows, obs_dim] with at least one row, got {np.shape(observations)}"
            )
        mean = np.asarray(np.mean(observations, axis=0, dtype=np.float64))
        squares, largest = np.zeros(observations.shape[1]), np.zeros(observations.shape[1])
        for first in range(0, len(observations), _PIECE):  # in pieces: a copy in double precision is twice the data
            piece = observations[first : first + _PIECE]
            squares += np.square(piece - mean).sum(axis=0)
            largest = np.maximum(largest, np.abs(piece).max(axis=0))
        std = np.sqrt(squares / len(observations))
        constant = np.flatnonzero(std <= _ROUNDING * largest)
        return cls(mean=mean, std=std, epsilon=epsilon, constant=tuple(constant.tolist()), applied=applied)

    @classmethod
    def identity(cls, obs_dim: int) -> "Normaliser":
        """Leaves observations as they are."""
        return cls(mean=np.zeros(obs_dim), std=np.ones(obs_dim), epsilon=0.0)

    def normalise(self, observations: Numbers) -> Numbers:
        """User's units to learner's; the last axis is `obs_dim`."""
        shifted = observations - _aligned(self.shift, observations)  # type: ignore
        shifted /= _aligned(self.scale, observations)  # in place where that is possible: the rows may be many
        return shifted

    def denormalise(self, observations: Numbers) -> Numbers:
        """Learner's units to the user's; a column that never varied takes its logged value."""
        return observations * _aligned(self._scale(0.0), observations) + _aligned(self.shift, observations)  # type: ignore

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; `from_dict` restores the same bits."""
        return {
            "mean": self.mean.tolist(),
            "std": self.std.tolist(),
            "epsilon": self.epsilon,
            "constant": list(self.constant),
            **({} if self.applied else {"applied": False}),
        }

    @classmethod
    def from_dict(cls, fields: Mapping[str, Any]) -> "Normaliser":
        """Inverse of `to_dict`; dictionaries from before `constant` scale every column, as they did."""
        return cls(
            np.asarray(fields["mean"]),
            np.asarray(fields["std"]),
            float(fields["epsilon"]),
            tuple(fields.get("constant", ())),
            bool(fields.get("applied", True)),
        )


@dataclass(frozen=True, kw_only=True)
class ObservationScaling:
    """How a learner sees observations; every learner has this setting."""

    observation_scaling: Literal["standard", "none"] = "standard"
    """"standard" gives each column mean 0 and standard deviation 1 in the log; "none" leaves columns that vary in the
    log's units."""

    def normaliser_of(self, observations: np.ndarray, epsilon: float = 0.0) -> Normaliser:
        """The map for these rows.

        Args:
            observations: [rows, obs_dim], in the user's units.
            epsilon: added to the standard deviations, in the user's units.

        Raises:
            ConfigError: the setting is not known.
        """
        if self.observation_scaling not in ("standard", "none"):
            raise ConfigError(
                f"observation_scaling={self.observation_scaling!r} is not known; known are 'standard', 'none'"
            )
        return Normaliser.fit(observations, epsilon, applied=self.observation_scaling == "standard")


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
