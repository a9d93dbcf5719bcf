"""Objectives of attacks on observations in float64 NumPy, written from their definitions."""

import numpy as np

from golden.networks import gaussian, numbers


def kl(mean, log_std, other_mean, other_log_std) -> float:
    """KL(p || q) of two diagonal Gaussians: log(sq/sp) + (sp^2 + (mp - mq)^2) / (2 sq^2) - 1/2 in each dimension."""
    total = 0.0
    for m, s, n, t in zip(*map(numbers, (mean, log_std, other_mean, other_log_std)), strict=True):
        own, other = np.exp(s), np.exp(t)
        total += float(np.log(other / own) + (own**2 + (m - n) ** 2) / (2 * other**2) - 0.5)
    return total


def symmetric_kl(mean, log_std, other_mean, other_log_std) -> float:
    """KL(p || q) + KL(q || p)."""
    return kl(mean, log_std, other_mean, other_log_std) + kl(other_mean, other_log_std, mean, log_std)


def gaussian_log(actor, observations) -> tuple[np.ndarray, np.ndarray]:
    """Mean and log standard deviation before the tanh."""
    mean, std = gaussian(actor, observations)
    return mean, np.log(std)
