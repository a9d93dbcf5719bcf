"""The factor on rewards by which the returns of a log's episodes span 1,000, as several papers scale locomotion."""

from odaf.components.numbers import Number
from odaf.data.dataset import Dataset
from odaf.errors import ConfigError

RETURN_SPAN = 1000.0  # of the best and the worst episode's return, once scaled


def scale_of_returns(dataset: Dataset, reward_shift: Number) -> float:
    """1,000 over the difference between the largest and the smallest return, rewards shifted first.

    Raises:
        ConfigError: all episodes return the same.
    """
    returns = dataset.episode_returns() + float(reward_shift) * dataset.episode_lengths()
    span = float(returns.max() - returns.min())
    if span <= 0.0:
        raise ConfigError(
            f"reward_scale='returns': every episode of the log returns {returns[0]:.6g}, so there is no span to "
            "scale; set a number, such as reward_scale=1.0"
        )
    return RETURN_SPAN / span
