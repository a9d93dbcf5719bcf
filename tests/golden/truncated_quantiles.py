"""Truncated quantile critics in float64 NumPy, one row, one quantile and one atom at a time."""

import numpy as np

from golden.networks import act, mlp, numbers


def quantiles(critics, observations, actions) -> np.ndarray:
    """theta_nm(s, a) as [critics, rows, quantiles]."""
    inputs = np.concatenate([numbers(observations), numbers(actions)], axis=1)
    return np.stack([mlp(critics, inputs, member) for member in range(critics.weights[0].shape[0])])


def targets(state, batch, noise, discount: float, dropped: int) -> list[list[float]]:
    """For each row: the pooled atoms, sorted, without the `dropped` times N largest, with reward and entropy."""
    actions, log_density = act(state.actor.now, batch.next_observations, noise)
    pooled = quantiles(state.critics.slow, batch.next_observations, actions)
    alpha = np.exp(float(state.log_temperature.now))
    rows = []
    for row in range(len(actions)):
        atoms = sorted(pooled[:, row].ravel().tolist())[: pooled.shape[0] * (pooled.shape[2] - dropped)]
        alive = 1.0 - float(batch.terminated[row])
        rows.append([float(batch.rewards[row]) + discount * alive * (z - alpha * log_density[row]) for z in atoms])
    return rows


def huber(x: float) -> float:
    """Half the square near zero, a straight line further out, smooth at 1."""
    return 0.5 * x * x if abs(x) <= 1.0 else abs(x) - 0.5


def quantile_loss(predicted, atoms) -> float:
    """Mean over quantiles m and atoms j of |tau_m - [y_j < theta_m]| H(y_j - theta_m), tau_m = (2m - 1) / (2M)."""
    count, total = len(predicted), 0.0
    for m, theta in enumerate(predicted, 1):
        tau = (2 * m - 1) / (2 * count)
        total += sum(abs(tau - (y < theta)) * huber(y - theta) for y in atoms)
    return total / (count * len(atoms))


def critic_loss(critics, batch, rows) -> float:
    """Sum over critics of the mean over rows."""
    predicted = quantiles(critics, batch.observations, batch.actions)
    return float(sum(np.mean([quantile_loss(p, atoms) for p, atoms in zip(q, rows, strict=True)]) for q in predicted))


def actor_loss(actor, critics, log_temperature, batch, noise) -> float:
    """Mean over rows of alpha log pi(a|s) minus the mean over critics and quantiles."""
    actions, log_density = act(actor, batch.observations, noise)
    value = quantiles(critics, batch.observations, actions).mean(axis=(0, 2))
    return float(np.mean(np.exp(float(log_temperature)) * log_density - value))
