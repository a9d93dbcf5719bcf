"""Whole episodes chosen from a data set, and set aside."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from odaf.data.mixture import Mixture
from odaf.data.rows import COLUMNS, Rows
from odaf.errors import DatasetError


def selected(dataset: Rows, chosen: Sequence[int] | np.ndarray) -> dict[str, Any]:
    """What `Dataset.select` changes: columns, infos, mixture and first rows of the episodes `chosen`, in that order."""
    slices = [dataset.episode(int(index)) for index in chosen]
    if not slices:
        raise DatasetError("Dataset.select: no episode was chosen; a dataset needs at least one")
    rows = np.concatenate([np.arange(part.start, part.stop) for part in slices])
    lengths = np.array([part.stop - part.start for part in slices])
    columns: dict[str, Any] = {name: getattr(dataset, name)[rows] for name in COLUMNS}
    columns["mixture"] = _mixture(dataset, slices)
    columns["infos"] = {name: values[rows] for name, values in dataset.infos.items()}
    return {**columns, "episode_starts": np.cumsum(lengths) - lengths}


def _mixture(dataset: Rows, slices: list[slice]) -> Mixture | None:
    """The mixture of the chosen episodes: the same ratio, with the border where their second part begins."""
    mixture = dataset.mixture
    if mixture is None:
        return None
    second = [part.start >= mixture.border for part in slices]
    if all(second) or not any(second) or second != sorted(second):
        fact = "their two parts are not in order" if any(second) and not all(second) else "only of one part"
        raise DatasetError(
            f"Dataset.select: batches of these data are mixed from two parts, and of the chosen episodes {fact}; "
            "choose episodes of both, those of the first part first, or choose and split before the parts are mixed"
        )
    border = sum(part.stop - part.start for part in slices if part.start < mixture.border)
    return Mixture(border, mixture.ratio)


def drawn(num_episodes: int, holdout: float, seed: int) -> dict[str, np.ndarray]:
    """Episodes in `train` and in `holdout`, ascending, drawn without replacement; see `Dataset.split`."""
    if not 0.0 < holdout < 1.0:
        raise DatasetError(f"Dataset.split: holdout is {holdout}; give a share between 0 and 1, for instance 0.2")
    if num_episodes < 2:
        raise DatasetError("Dataset.split: one episode cannot be split into whole episodes; log more of them")
    count = min(max(round(holdout * num_episodes), 1), num_episodes - 1)
    order = np.random.default_rng(seed).permutation(num_episodes)
    return {"train": np.sort(order[count:]), "holdout": np.sort(order[:count])}
