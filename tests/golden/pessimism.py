"""The pessimistic term of RORL and PBRL in float64 NumPy."""

import numpy as np

from golden.networks import act, numbers, q_values, spread


def pull_down(
    critics, actor, states, noise, deviations: float, *, ddof=0, floor=None, bounds=None, fixed_critics=None
) -> float:
    """Mean over members and rows of (Q_k - t_k)^2 with t_k = Q_k - deviations std_j Q_j, cut at floor and bounds.

    The targets come from `fixed_critics` if given, so that numerical derivatives can hold them fast.
    """
    actions, _ = act(actor, states, noise)
    values = q_values(critics, states, actions)
    before = q_values(critics if fixed_critics is None else fixed_critics, states, actions)
    total, count = 0.0, 0
    for member, held in zip(values, before, strict=True):
        lowered = held - deviations * spread(before, ddof)
        if bounds is not None:
            lowered = np.minimum(np.maximum(lowered, bounds[0]), bounds[1])
        if floor is not None:
            lowered = np.maximum(lowered, floor)
        total += float(np.sum((member - lowered) ** 2))
        count += len(member)
    return total / count


def repeated(states, offsets) -> np.ndarray:
    """Every state with every offset, draw by draw."""
    return np.concatenate([numbers(states) + numbers(offset) for offset in offsets])
