"""Options of every command that estimates values: how policies act, what is counted, sizes of the fits."""

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class EstimatorOptions:
    """How values are estimated."""

    acting: Literal["mode", "draws"] = "mode"
    """Actions to judge: `mode`, those that a deployed policy takes, or `draws`, a stochastic policy that draws them."""
    discount: float = 1.0
    """Weight of a reward one step later; 1 gives plain sums."""
    horizon: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Steps of an episode to count; without it, what the log shows: the median length of recordings that were cut, or
    the longest episode if none was."""
    log_probs: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None
    """Column of the data's infos with the log-density of each logged action in nats, such as action_log_probs; without
    it, the density is estimated."""
    seed: int = 0
    """Of the fits and of resampled episodes; equal seeds give equal results."""
    steps: int = 20_000
    """Gradient steps of each fit, at most."""
    members: int = 8
    """Networks of fitted Q and of the model, each with resampled episodes of its own."""
