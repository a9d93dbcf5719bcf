"""What is drawn, as plain arrays; no drawing library is needed to make them."""

from dataclasses import dataclass

import numpy as np

FLAGS = {"stitched": "stitch", "success": "reach the goal"}
"""What an environment may report of an episode, the more telling first, and what those do of which it is true."""


@dataclass(frozen=True)
class Curve:
    """A quantity of one method over training.

    Attributes:
        label: the method.
        steps: [points] updates.
        values: [seeds, points], NaN where a seed has no value there.
        spread: [points] standard deviation over episodes, or `None` where there is no such thing.
        index: the method's place in the report, which decides colour and dashes.
    """

    label: str
    steps: np.ndarray
    values: np.ndarray
    spread: np.ndarray | None
    index: int


@dataclass(frozen=True)
class Returns:
    """Episode returns of one row in the picture of returns: the log itself (`index` is `None`) or a method."""

    label: str
    returns: np.ndarray
    mean: float | None
    interval: tuple[float, float] | None
    index: int | None


@dataclass(frozen=True)
class Trajectories:
    """Paths in a maze.

    Attributes:
        positions: [episodes, time, 2], NaN after an episode's end.
        good: [episodes] bool, whether an episode does what counts, or `None` where the environment does not tell.
        doing: what that is, of several episodes: they "stitch", or they "reach the goal".
    """

    positions: np.ndarray
    good: np.ndarray | None = None
    doing: str = "stitch"
