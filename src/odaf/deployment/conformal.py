"""When a score is high enough for an alarm: a threshold whose rate of false alarms is promised, by episode.

With m_1..m_n the largest scores of n episodes set aside,

    k = ceil( (n + 1) (1 - alpha) ),     threshold = the k-th smallest m,     alarm: score > threshold

(split conformal prediction, Vovk et al. 2005). If the next episode is drawn as these were, each rank of its largest
score among the n + 1 is as likely as any other, so that

    P( an alarm in the episode ) <= 1 - k / (n + 1) <= alpha

whatever the score is and however its values depend on one another within an episode. Rows are not exchangeable,
episodes are. With fewer than 1 / alpha - 1 episodes no threshold below infinity can promise this.
"""

import math
from dataclasses import dataclass

import numpy as np

from odaf.errors import ConfigError, DatasetError

_ROUNDING = 1e-9  # of (n + 1) (1 - alpha), which may lie a rounding error above a whole number


@dataclass(frozen=True)
class Calibration:
    """A threshold and what it rests on.

    Attributes:
        threshold: a larger score is an alarm.
        false_alarms: alpha, the rate that was asked for, by episode.
        promised: 1 - k / (n + 1), the rate that holds, at most alpha.
        episodes: n.
        episode_steps: rows that made an episode; None where the recording's own episodes did.
        median_length: of the episodes, in steps.
    """

    threshold: float
    false_alarms: float
    promised: float
    episodes: int
    episode_steps: int | None
    median_length: int


def calibrate(
    maxima: np.ndarray, false_alarms: float, lengths: np.ndarray, episode_steps: int | None = None
) -> Calibration:
    """The threshold for the largest scores [n] of n episodes, of `lengths` [n] steps.

    Raises:
        ConfigError: the rate is none.
        DatasetError: so few episodes promise no such rate.
    """
    if not 0.0 < false_alarms < 1.0:
        raise ConfigError(
            f"false_alarms={false_alarms} must lie between 0 and 1: the share of sound episodes with an alarm, "
            "for instance 0.01"
        )
    episodes = len(maxima)
    rank = math.ceil((episodes + 1) * (1.0 - false_alarms) - _ROUNDING)
    if rank > episodes:
        raise DatasetError(
            f"false_alarms={false_alarms:g} needs {episodes_for(false_alarms):,} episodes set aside, and there are "
            f"{episodes:,}, which promise {1.0 / (episodes + 1):.2g} at best; log more of them, set a larger share "
            "aside before training (`odaf data split --share`), ask for a higher rate, or cut long recordings with "
            "episode_steps="
        )
    threshold = float(np.sort(np.asarray(maxima, np.float64))[rank - 1])
    promised = 1.0 - rank / (episodes + 1)
    return Calibration(threshold, false_alarms, promised, episodes, episode_steps, int(np.median(lengths)))


def episodes_for(false_alarms: float) -> int:
    """The fewest episodes that promise this rate."""
    return math.ceil(1.0 / false_alarms - 1.0 - _ROUNDING)


def pieces(starts: np.ndarray, rows: int, steps: int | None) -> np.ndarray:
    """First rows of what counts as an episode: recordings, or with `steps` pieces of so many rows of each.

    A shorter rest belongs to the piece before it, so that no piece is short.

    Args:
        starts: [E], the first row of each recording, ascending from 0.
        rows: in all.
        steps: rows a piece; None leaves recordings whole.

    Raises:
        ConfigError: fewer than one row a piece.
    """
    if steps is None:
        return starts
    if steps < 1:
        raise ConfigError(f"episode_steps={steps} must be at least 1; leave it out where recordings are the episodes")
    ends = np.append(starts[1:], rows)
    found = [
        first + steps * np.arange(max((last - first) // steps, 1)) for first, last in zip(starts, ends, strict=True)
    ]
    return np.concatenate(found)
