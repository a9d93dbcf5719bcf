"""Losses of the ensemble soft actor-critic (SAC-N), row by row in float64 NumPy."""

import numpy as np

from golden.networks import act, numbers, q_values


def target(state, batch, noise, discount: float, entropy_in_backup: bool, bounds=None) -> np.ndarray:
    """y = r + discount (1 - d) (min_k Q'_k(s', a') [- alpha log pi(a'|s')]), cut to the bounds.

    For rows that span n steps the caller gives the discount to the power n.
    """
    actions, log_density = act(state.actor.now, batch.next_observations, noise)
    values = q_values(state.target_critics, batch.next_observations, actions)
    alpha = np.exp(float(state.log_temperature.now))
    y = []
    for row in range(len(actions)):
        value = min(values[:, row])
        if entropy_in_backup:
            value -= alpha * log_density[row]
        alive = 1.0 - float(batch.terminated[row])
        y.append(float(batch.rewards[row]) + discount * alive * value)
    return np.array(y) if bounds is None else np.minimum(np.maximum(y, bounds[0]), bounds[1])


def critic_loss(critics, batch, y) -> float:
    """Sum over members of the mean over rows of (Q_k - y)^2."""
    values = q_values(critics, batch.observations, batch.actions)
    return float(sum(np.mean((member - y) ** 2) for member in values))


def actor_loss(actor, critics, log_temperature, batch, noise) -> float:
    """Mean over rows of alpha log pi(a|s) - min_k Q_k(s, a)."""
    actions, log_density = act(actor, batch.observations, noise)
    lowest = q_values(critics, batch.observations, actions).min(axis=0)
    return float(np.mean(np.exp(float(log_temperature)) * log_density - lowest))


def temperature_loss(log_temperature, log_density, target_entropy: float) -> float:
    """-mean(log alpha (log pi + H))."""
    return float(-np.mean(float(log_temperature) * (numbers(log_density) + target_entropy)))
