"""How batches of a data set of two parts are to be mixed."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from odaf.errors import DatasetError


@dataclass(frozen=True)
class Mixture:
    """Batches take each of their rows from the second part with probability `ratio`, else from the first.

    Attributes:
        border: number of rows of the first part, the better one; the second part begins there.
        ratio: share of the second part in a batch, strictly between 0 and 1.
    """

    border: int
    ratio: float

    def __post_init__(self):
        if not 0.0 < self.ratio < 1.0:
            raise DatasetError(
                f"mix: ratio is {self.ratio}; give the share of the poorer rows, between 0 and 1, such as 0.7"
            )

    def check(self, source: str, episode_starts: np.ndarray) -> None:
        """Raises `DatasetError` unless an episode other than the first begins at the border."""
        if self.border <= 0 or self.border not in episode_starts:
            raise DatasetError(
                f"{source}: mixture: no second part begins in row {self.border:,}; the border must be the first row of "
                "an episode: make the file again with `odaf data mix`"
            )

    def to_dict(self) -> dict[str, Any]:
        """JSON types; inverse of `from_dict`."""
        return asdict(self)

    @classmethod
    def from_dict(cls, content: Mapping[str, Any]) -> "Mixture":
        """The mixture that `to_dict` wrote."""
        return cls(int(content["border"]), float(content["ratio"]))
