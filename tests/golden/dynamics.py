"""Dynamics models in float64 NumPy: predictions and training losses."""

import numpy as np

from golden.networks import mlp, numbers


def _state(model, observations, output) -> np.ndarray:
    state = numbers(model.shift) + numbers(model.scale) * output
    return numbers(observations) + state if model.residual else state


def _output(model, observations, next_observations) -> np.ndarray:
    base = numbers(observations) if model.residual else 0.0
    return (numbers(next_observations) - base - numbers(model.shift)) / numbers(model.scale)


def _joined(*columns) -> np.ndarray:
    return np.concatenate([numbers(column) for column in columns], axis=1)


def deterministic(model, observations, actions, noise=()) -> np.ndarray:
    """s' = [s +] shift + scale f(s, a)."""
    assert len(noise) == 0
    return _state(model, observations, mlp(model.network, _joined(observations, actions)))


def deterministic_loss(model, observations, actions, next_observations) -> float:
    """Mean squared error of the scaled output."""
    error = mlp(model.network, _joined(observations, actions)) - _output(model, observations, next_observations)
    return float(np.mean(error**2))


def cvae(model, observations, actions, noise) -> np.ndarray:
    """Decode z ~ q(z|s, a), or z from the prior cut to +-0.5 if the encoder needs the next state."""
    if model.cvae.sees_target:
        latent = np.minimum(np.maximum(numbers(noise), -0.5), 0.5)
    else:
        mean, log_std = np.split(mlp(model.cvae.encoder, _joined(observations, actions)), 2, axis=1)
        latent = mean + np.exp(log_std) * numbers(noise)
    return _state(model, observations, mlp(model.cvae.decoder, _joined(observations, actions, latent)))


def cvae_loss(model, observations, actions, next_observations, noise) -> float:
    """Squared error + 0.5 KL(N(mu, sigma^2) || N(0, 1)); both are means over rows and over dimensions."""
    condition = _joined(observations, actions)
    if model.cvae.sees_target:
        condition = _joined(observations, actions, next_observations)
    mean, log_std = np.split(mlp(model.cvae.encoder, condition), 2, axis=1)
    std = np.exp(log_std)
    latent = mean + std * numbers(noise)
    output = mlp(model.cvae.decoder, _joined(observations, actions, latent))
    error = output - _output(model, observations, next_observations)
    # KL of two normals, term by term: log(1 / sigma) + (sigma^2 + mu^2) / 2 - 1 / 2
    divergence = np.log(1.0 / std) + (std**2 + mean**2) / 2.0 - 0.5
    return float(np.mean(error**2) + 0.5 * np.mean(divergence))


def gaussian_moments(model, inputs, member: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance of one member's output, the log-variance softly held between two learnt bounds."""
    mean, log_variance = np.split(mlp(model.network, inputs, member), 2, axis=1)
    high, low = numbers(model.log_variance_max), numbers(model.log_variance_min)
    log_variance = high - np.log1p(np.exp(high - log_variance))
    log_variance = low + np.log1p(np.exp(log_variance - low))
    return mean, np.exp(log_variance)


def ensemble(model, observations, actions, noise) -> np.ndarray:
    """A draw from the member that the noise names for each row."""
    members, normal = np.asarray(noise[0]), numbers(noise[1])
    inputs = _joined(observations, actions)
    output = np.empty_like(normal)
    for row, member in enumerate(members):
        mean, variance = gaussian_moments(model, inputs[row : row + 1], member)
        output[row] = mean[0] + np.sqrt(variance[0]) * normal[row]
    return _state(model, observations, output)


def ensemble_loss(model, observations, actions, next_observations) -> float:
    """Twice the Gaussian negative log-likelihood without its constant, meaned over rows and dimensions and summed over
    members that see rows of their own, plus 0.01 (sum of upper - sum of lower log-variance bounds)."""
    total = 0.01 * float(numbers(model.log_variance_max).sum() - numbers(model.log_variance_min).sum())
    for member in range(len(observations)):
        mean, variance = gaussian_moments(model, _joined(observations[member], actions[member]), member)
        error = mean - _output(model, observations[member], next_observations[member])
        total += float(np.mean(error**2 / variance) + np.mean(np.log(variance)))
    return total


PREDICT = {"deterministic": deterministic, "cvae": cvae, "ensemble": ensemble}
