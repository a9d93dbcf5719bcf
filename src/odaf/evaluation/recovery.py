"""How long a policy takes to come back to where the log has been."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import KDTree

from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import DatasetError

_PERCENTILE = 95.0
_HELD_SHARE = 0.1


@dataclass(frozen=True)
class KnownGround:
    """A sample of logged states, and how near to them a state must be to count as one like them.

    Attributes:
        tree: the sample, in normalised units.
        rows: states in it.
        threshold: 95th percentile of the distances from other logged episodes' states to their nearest neighbour in the
            sample, in normalised units.
        normaliser: from the user's units to those.
    """

    tree: KDTree
    rows: int
    threshold: float
    normaliser: Normaliser

    @classmethod
    def of(
        cls, dataset: Dataset, normaliser: Normaliser, *, rows: int = 20_000, checked: int = 2_000, seed: int = 0
    ) -> "KnownGround":
        """Samples the log: a tenth of its episodes gives the threshold, the others give the states.

        Whole episodes are held back, because the neighbours of a state in its own episode are nearer than those that
        any new path could have.

        Args:
            dataset: the log.
            normaliser: fitted on it.
            rows: most states in the sample.
            checked: most distances that the threshold is taken from.
            seed: of the sampling.

        Raises:
            DatasetError: there is one episode only.
        """
        if dataset.num_episodes < 2:
            raise DatasetError(
                "the log has one episode; a known ground needs two or more, one to measure the others by"
            )
        normaliser = replace(
            normaliser, applied=True
        )  # distances weigh columns by their spread, whatever a learner sees
        random = np.random.default_rng(seed)
        held = random.permutation(dataset.num_episodes)[: max(round(_HELD_SHARE * dataset.num_episodes), 1)]
        is_held = np.repeat(np.isin(np.arange(dataset.num_episodes), held), dataset.episode_lengths())
        sampled, measured = (
            np.sort(random.permutation(np.flatnonzero(chosen))[:most])
            for chosen, most in ((~is_held, rows), (is_held, checked))
        )
        tree = KDTree(normaliser.normalise(dataset.observations[sampled]))
        distances, _ = tree.query(normaliser.normalise(dataset.observations[measured]))
        return cls(tree, len(sampled), float(np.percentile(distances, _PERCENTILE)), normaliser)

    def distances(self, observations: np.ndarray) -> np.ndarray:
        """From states [rows, obs_dim] in the user's units to the nearest logged state, in normalised units: [rows]."""
        return self.tree.query(self.normaliser.normalise(observations))[0]

    def recovery(self, observations: np.ndarray) -> np.ndarray:
        """Steps until each episode is first within the threshold; infinite where it ends before.

        Args:
            observations: [episodes, time, obs_dim] in the user's units, NaN after an episode's end.

        Returns:
            [episodes] float64, 0 for one that is there at the first time.
        """
        steps = np.full(len(observations), np.inf)
        for time in range(observations.shape[1]):
            waiting = np.flatnonzero(np.isinf(steps) & np.isfinite(observations[:, time]).all(axis=-1))
            if waiting.size == 0:
                break
            steps[waiting[self.distances(observations[waiting, time]) <= self.threshold]] = time
        return steps
