"""A tanh-Gaussian policy in plain NumPy: what acts in the simulator, on its own or from a shipped file."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from odaf.components.distributions import LOG_TWO_PI
from odaf.components.policies import LOG_STD_MAX, LOG_STD_MIN


@dataclass(frozen=True)
class GaussianPolicy:
    """obs -> hidden layers with ReLU -> mean and log standard deviation before the tanh.

    Attributes:
        weights: `(in, out)` each.
        biases: `(out,)` each.
        spread: factor on the standard deviation; 1 acts as trained.
    """

    weights: Sequence[np.ndarray]
    biases: Sequence[np.ndarray]
    spread: float = 1.0

    def parameters(self, observations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and log standard deviation, clipped to [-5, 2] before the spread, of the Gaussian before squashing."""
        x = np.asarray(observations, dtype=np.float32)
        last = len(self.weights) - 1
        for index, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            x = x @ weight
            x += bias
            if index < last:
                np.maximum(x, 0.0, out=x)
        half = x.shape[-1] // 2
        return x[..., :half], np.clip(x[..., half:], LOG_STD_MIN, LOG_STD_MAX) + np.float32(math.log(self.spread))

    def mode(self, observations: np.ndarray) -> np.ndarray:
        """Deterministic action tanh(mean)."""
        return np.tanh(self.parameters(observations)[0])

    def sample(self, observations: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Action in (-1, 1) for given standard normal noise."""
        mean, log_std = self.parameters(observations)
        return np.tanh(mean + np.exp(log_std) * noise)

    def sample_with_density(self, observations: np.ndarray, noise: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same action, and its log-density summed over action dimensions, in nats.

        The slope of the squashing is taken from the number u before it, log(1 - tanh(u)^2) = 2 (log 2 - |u| - log(1 +
        exp(-2 |u|))), in double precision: it holds its digits where the action itself is rounded to a bound.
        """
        mean, log_std = self.parameters(observations)
        before_tanh = mean + np.exp(log_std) * noise
        size = np.abs(before_tanh.astype(np.float64))
        slope = 2.0 * (math.log(2.0) - size - np.log1p(np.exp(-2.0 * size)))
        density = np.sum(-0.5 * (np.square(noise) + LOG_TWO_PI) - log_std - slope, axis=-1)
        return np.tanh(before_tanh), density.astype(np.float32)
