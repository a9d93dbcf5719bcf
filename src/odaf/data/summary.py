"""What a data set holds, in JSON types: for `odaf data info`, the run directory and the report."""

from typing import Any

import numpy as np

from odaf.data import validation
from odaf.data.rows import Rows


def summarise(dataset: Rows) -> dict[str, Any]:
    """Counts, returns, names, bounds and provenance; see `Dataset.summary`."""
    returns, lengths = dataset.episode_returns(), dataset.episode_lengths()
    terminated = dataset.terminated[dataset.episode_starts + lengths - 1]
    short = fragments(lengths, terminated)
    whole, per_step = returns[~short], (returns / lengths)[~short]
    mixture = dataset.mixture
    return {
        "transitions": len(dataset),
        "episodes": dataset.num_episodes,
        "mean_return": float(returns.mean()),
        "std_return": float(returns.std()),
        "best_return": float(whole.max()),
        "worst_return": float(whole.min()),
        "mean_reward": float(returns.sum() / len(dataset)),
        "best_mean_reward": float(per_step.max()),
        "worst_mean_reward": float(per_step.min()),
        "fragments": int(short.sum()),
        "mean_length": float(lengths.mean()),
        "terminal_share": float(terminated.mean()),
        "observation_names": list(dataset.observation_names),
        "action_names": list(dataset.action_names),
        "observation_units": list(dataset.observation_units or ()),
        "action_units": list(dataset.action_units or ()),
        "infos": sorted(dataset.infos),
        "action_low": dataset.action_low.tolist(),
        "action_high": dataset.action_high.tolist(),
        **({} if mixture is None else {"mixture": mixture.to_dict()}),
        "provenance": validation.plain_json("Dataset.summary", dataset.provenance),
    }


def fragments(lengths: np.ndarray, terminated: np.ndarray) -> np.ndarray:
    """[E] bool: episodes cut by the recording before they were half as long as others, whose returns say little.

    What is usual is the length that half of all rows lie in episodes of at most. An episode that ended by itself is
    none, however short: its return is all that there was to earn.

    Args:
        lengths: [E] steps.
        terminated: [E] whether the task ended the episode.
    """
    order = np.argsort(lengths, kind="stable")
    rows = np.cumsum(lengths[order])
    usual = lengths[order[np.searchsorted(rows, rows[-1] / 2)]]
    return ~terminated & (2 * lengths < usual)
