"""Sets of `odaf data generate` as sound logs; their plants are what they are, so only logs of them can be spoiled."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.faults.simulation import Rows

ROWS = 15_000


@dataclass
class Recorded:
    """One set, recorded when it is first asked for.

    Attributes:
        name: what `odaf data generate` calls it.
    """

    name: str
    _rows: dict[int, Rows] = field(default_factory=dict)

    def make(self, seed: int, tampering: Any = None, wrap: Any = None, length: int | None = None) -> Rows:
        """The log, as `Kind.make`.

        Raises:
            NotImplementedError: another plant, controller or length of episodes is asked for.
        """
        if tampering is not None or wrap is not None or length is not None:
            raise NotImplementedError(self.name)
        if seed not in self._rows:
            self._rows[seed] = self._record(seed)
        return replace(self._rows[seed])

    def _record(self, seed: int) -> Rows:
        from odaf.environments import locomotion_data, stitch_data

        if self.name == "pointmaze-stitch":
            dataset = stitch_data.generate(seed=seed)
            dataset = dataset.select(np.arange(0, dataset.num_episodes, 5))
        else:
            dataset = locomotion_data.generate(self.name, ROWS, seed)
        return Rows(
            dataset.observations.astype(float),
            dataset.actions.astype(float),
            dataset.rewards.astype(float),
            np.repeat(np.arange(dataset.num_episodes), dataset.episode_lengths()),
            dataset.terminated,
            dataset.truncated,
            (dataset.action_low.astype(float), dataset.action_high.astype(float)),
            next_observations=dataset.next_observations.astype(float),
        )


RECORDED = {
    name: Recorded(name)
    for name in (
        "pointmaze-stitch",
        "hopper-random",
        "hopper-medium-replay",
        "hopper-expert",
        "halfcheetah-random",
        "halfcheetah-expert",
        "walker2d-medium",
        "walker2d-medium-replay",
    )
}
