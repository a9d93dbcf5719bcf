"""What a data set holds, in JSON types: for `odaf data info`, the run directory and the report."""

from typing import Any

from odaf.data import validation
from odaf.data.rows import Rows


def summarise(dataset: Rows) -> dict[str, Any]:
    """Counts, returns, names, bounds and provenance; see `Dataset.summary`."""
    returns, lengths = dataset.episode_returns(), dataset.episode_lengths()
    mixture = dataset.mixture
    return {
        "transitions": len(dataset),
        "episodes": dataset.num_episodes,
        "mean_return": float(returns.mean()),
        "std_return": float(returns.std()),
        "best_return": float(returns.max()),
        "worst_return": float(returns.min()),
        "mean_length": float(lengths.mean()),
        "terminal_share": float(dataset.terminated[dataset.episode_starts + lengths - 1].mean()),
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
