"""Evaluations that were played in parts, put together again."""

from collections.abc import Sequence

import numpy as np

from odaf.evaluation.rollouts import Episodes


def in_one(parts: Sequence[Episodes]) -> Episodes:
    """All episodes of the parts, in their order; NaN fills up those of parts that ended sooner.

    A flag is kept if every part that has a sound episode tells it; the broken episodes of another count as False.
    """
    longest = max(part.rewards.shape[1] for part in parts)
    telling = [part for part in parts if len(part.broken) < len(part.returns)]
    names = [name for name in (telling or parts)[0].flags if all(name in part.flags for part in telling)]
    firsts = np.cumsum([0, *(len(part.returns) for part in parts)]).tolist()
    broken = {}
    for first, part in zip(firsts, parts, strict=False):
        broken |= {first + index: what for index, what in part.broken.items()}
    return Episodes(
        np.concatenate([_padded(part.observations, longest + 1) for part in parts]),
        np.concatenate([_padded(part.rewards, longest) for part in parts]),
        np.concatenate([part.lengths for part in parts]),
        np.concatenate([part.returns for part in parts]),
        {
            name: np.concatenate([part.flags.get(name, np.zeros(len(part.returns), bool)) for part in parts])
            for name in names
        },
        broken,
    )


def _padded(array: np.ndarray, times: int) -> np.ndarray:
    """With `times` places along its second axis."""
    widths = [(0, 0), (0, times - array.shape[1]), *[(0, 0)] * (array.ndim - 2)]
    return np.pad(array, widths, constant_values=np.nan)
