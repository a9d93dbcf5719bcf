"""How an estimate is made: sizes of what is fitted, and of the resampling."""

from dataclasses import dataclass
from typing import Any, Literal

from odaf.errors import ConfigError

Acting = Literal["mode", "draws"]  # actions that a deployed policy takes, or draws from it


@dataclass(frozen=True)
class EstimateSettings:
    """Sizes of what is fitted, and how intervals are made."""

    members: int = 8
    """Networks of fitted Q, and of the model, each with resampled episodes of its own."""
    hidden_sizes: tuple[int, ...] = (128, 128)
    """Widths of all their hidden layers, and of the behaviour density's."""
    steps: int = 20_000
    """Gradient steps of each fit, at most."""
    batch_size: int = 128
    """Rows a gradient step (and a member)."""
    learning_rate: float = 3e-4
    """Step size of Adam."""
    patience: int = 5
    """Checks without a lower error on episodes held out, one every 1,000 steps, that end a fit."""
    early_stopping: bool = False
    """End fitted Q, too, by its Bellman error on episodes held out: for small logs of short episodes alone."""
    resamples: int = 1_000
    """Of the episodes, for intervals."""
    confidence: float = 0.95
    """Of all intervals."""

    def __post_init__(self) -> None:
        for field, least in (("members", 2), ("steps", 1), ("batch_size", 1), ("patience", 1), ("resamples", 2)):
            if getattr(self, field) < least:
                raise ConfigError(f"{field}={getattr(self, field)} must be at least {least}")
        if not self.hidden_sizes or min(self.hidden_sizes) < 1:
            raise ConfigError(f"hidden_sizes={self.hidden_sizes} must be one or more widths of at least 1")
        if not self.learning_rate > 0.0:
            raise ConfigError(f"learning_rate={self.learning_rate} must be above 0")
        if not 0.0 < self.confidence < 1.0:
            raise ConfigError(f"confidence={self.confidence} must lie between 0 and 1, for instance 0.95")

    def fitting(self) -> dict[str, Any]:
        """What both fits take."""
        names = ("hidden_sizes", "steps", "batch_size", "learning_rate")
        return {name: getattr(self, name) for name in names}
