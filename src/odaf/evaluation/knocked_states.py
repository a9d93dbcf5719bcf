"""Where a policy goes after a knock, beside where its log has been: on the log's principal axes, and by distance."""

from dataclasses import dataclass

import numpy as np

from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.evaluation.recovery import KnownGround

SAMPLE = 20_000  # logged states that the axes are fitted to


@dataclass(frozen=True)
class Axes:
    """The two directions in which logged states differ most, in normalised units.

    Attributes:
        mean: [obs_dim].
        directions: [2, obs_dim], of unit length; the largest entry of each is positive, which settles its sign.
        share: of the variance, by each.
    """

    mean: np.ndarray
    directions: np.ndarray
    share: tuple[float, float]

    @classmethod
    def of(cls, states: np.ndarray) -> "Axes":
        """From states [rows, obs_dim] in normalised units."""
        mean = states.mean(axis=0)
        values, vectors = np.linalg.eigh(np.cov((states - mean).T))
        found = vectors[:, ::-1][:, :2].T
        signs = np.sign(found[np.arange(2), np.abs(found).argmax(axis=1)])
        first, second = (values[::-1] / values.sum())[:2]
        return cls(mean, found * signs[:, None], (float(first), float(second)))

    def place(self, states: np.ndarray) -> np.ndarray:
        """Coordinates [rows, 2] of states [rows, obs_dim] in normalised units."""
        return (states - self.mean) @ self.directions.T


@dataclass(frozen=True)
class KnockedStates:
    """States after the knock, of the episodes that were knocked.

    Attributes:
        beyond: share of the steps at which the state lies further from the log than the 95th percentile of logged
            ones, or the episode has ended: a fall is no return.
        recovery: steps until an episode is first back, by episode; infinite where it ended before.
        points: [states, 2] on the axes.
        log: [sample, 2] logged states on the same axes.
        episodes: knocked.
    """

    beyond: float
    recovery: np.ndarray
    points: np.ndarray
    log: np.ndarray
    episodes: int


def knocked_states(
    dataset: Dataset, normaliser: Normaliser, ground: KnownGround, observations: np.ndarray, seed: int = 0
) -> KnockedStates | None:
    """Lays states after a knock beside a log.

    Args:
        dataset: the log.
        normaliser: fitted on it.
        ground: of the log.
        observations: [episodes, time, obs_dim] from the knock on, NaN after an episode's end; knocked episodes only.
        seed: of the sample of the log.

    Returns:
        None where no episode was knocked.
    """
    if len(observations) == 0:
        return None
    rows = np.sort(np.random.default_rng(seed).permutation(len(dataset))[:SAMPLE])
    logged = normaliser.normalise(dataset.observations[rows])
    axes = Axes.of(logged)
    states = observations[np.isfinite(observations).all(axis=-1)]
    near = int(np.sum(ground.distances(states) <= ground.threshold))
    return KnockedStates(
        1.0 - near / (observations.shape[0] * observations.shape[1]),
        ground.recovery(observations),
        axes.place(normaliser.normalise(states)),
        axes.place(logged),
        len(observations),
    )
