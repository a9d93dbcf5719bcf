"""What BCQ and BEAR are made of, in float64 NumPy."""

import numpy as np

from golden.networks import mlp, numbers, q_values
from odaf.components.critics import CriticEnsemble


def decoded(behaviour, observations, noise) -> np.ndarray:
    """The decoder's output before the tanh, for noise of the prior cut to plus or minus a half."""
    latent = np.minimum(np.maximum(numbers(noise), -0.5), 0.5)
    return mlp(behaviour.cvae.decoder, np.concatenate([numbers(observations), latent], axis=1))


def behaviour_loss(behaviour, batch, noise) -> float:
    """Mean squared error of the decoded action, and half the mean divergence from N(0, 1); the noise is not cut."""
    states, actions = numbers(batch.observations), numbers(batch.actions)
    output = mlp(behaviour.cvae.encoder, np.concatenate([states, actions], axis=1))
    half = output.shape[1] // 2
    mean, log_std = output[:, :half], np.minimum(np.maximum(output[:, half:], -4.0), 15.0)
    std = np.exp(log_std)
    latent = mean + std * numbers(noise)
    action = np.tanh(mlp(behaviour.cvae.decoder, np.concatenate([states, latent], axis=1)))
    divergence = -0.5 * np.mean(1.0 + np.log(std**2) - mean**2 - std**2)
    return float(np.mean((action - actions) ** 2) + 0.5 * divergence)


def best_target(critics, batch, candidates: np.ndarray, discount: float) -> np.ndarray:
    """r + discount (1 - d) max_i (0.75 min_k Q_k + 0.25 max_k Q_k), row by row."""
    values = np.stack([q_values(CriticEnsemble(critics), batch.next_observations, draw) for draw in candidates])
    y = []
    for row in range(values.shape[2]):
        best = max(0.75 * min(of_draw[:, row]) + 0.25 * max(of_draw[:, row]) for of_draw in values)
        alive = 0.0 if float(batch.terminated[row]) else 1.0
        y.append(float(batch.rewards[row]) + discount * alive * best)
    return np.array(y)


def best_by_first(critics, observations, candidates: np.ndarray) -> np.ndarray:
    """The candidate of each row that the first critic values most."""
    values = np.stack([q_values(CriticEnsemble(critics), observations, draw)[0] for draw in candidates])
    return candidates[values.argmax(axis=0), np.arange(values.shape[1])]
