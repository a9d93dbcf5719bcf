"""RORL's two smoothing losses in float64 NumPy, state by state and draw by draw."""

import numpy as np

from golden.networks import gaussian, numbers, q_values


def divergence(mean, std, other_mean, other_std) -> float:
    """KL between diagonal normals from its definition: E_p[log p - log q], dimension by dimension."""
    total = 0.0
    for m, s, n, t in zip(mean, std, other_mean, other_std, strict=True):
        # E_p[-(x - m)^2 / 2s^2] = -1/2 and E_p[(x - n)^2] = s^2 + (m - n)^2
        total += np.log(t) - np.log(s) - 0.5 + (s**2 + (m - n) ** 2) / (2.0 * t**2)
    return float(total)


def policy_changes(actor, states, offsets) -> np.ndarray:
    """J for every draw and state: [draws, rows]."""
    states = numbers(states)
    mean, std = gaussian(actor, states)
    changes = np.zeros(offsets.shape[:2])
    for draw, offset in enumerate(numbers(offsets)):
        there, spread = gaussian(actor, states + offset)
        for row in range(len(states)):
            here, moved = (mean[row], std[row]), (there[row], spread[row])
            changes[draw, row] = divergence(*here, *moved) + divergence(*moved, *here)
    return changes


def value_changes(critics, states, actions, offsets, fall_weight: float) -> np.ndarray:
    """l for every draw and state: [draws, rows]."""
    states = numbers(states)
    before = q_values(critics, states, actions)
    changes = np.zeros(offsets.shape[:2])
    for draw, offset in enumerate(numbers(offsets)):
        after = q_values(critics, states + offset, actions)
        for row in range(len(states)):
            total = 0.0
            for rise in after[:, row] - before[:, row]:
                total += (1.0 - fall_weight) * max(rise, 0.0) ** 2 + fall_weight * min(rise, 0.0) ** 2
            changes[draw, row] = total / len(before)
    return changes


def worst(changes: np.ndarray) -> float:
    """Mean over states of the largest over draws."""
    return float(np.mean([max(column) for column in changes.T]))
