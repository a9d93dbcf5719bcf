"""ODAF's term in float64 NumPy, from the paper's Algorithm 1: perturb, act, predict, act, disagree, worst case."""

import numpy as np

from golden.networks import act, mode, numbers, q_values, spread


def uncertainty(
    perturbed,
    actor,
    next_actor,
    critics,
    predict,
    noise,
    *,
    next_action="sample",
    next_action_at="outcome",
    ddof=0,
    fixed_next_action=None,
) -> np.ndarray:
    """U = std_k Q_k(s^', a^') with a^ ~ pi(s^), s^' = P(s^, a^), a^' ~ pi'(s^').

    Args:
        perturbed: s^, one a row.
        actor: pi.
        next_actor: the policy that acts at the predicted state.
        critics: Q_1..Q_K.
        predict: (s, a, noise) -> s'.
        noise: draws of a^, of the model and of a^'.
        next_action: "sample" or "mode".
        next_action_at: "outcome", or "perturbed" to choose a^' at s^.
        ddof: of the standard deviation.
        fixed_next_action: used for a^' if given, so that numerical derivatives can leave it out.
    """
    action, _ = act(actor, perturbed, noise[0])
    outcome = predict(perturbed, action, noise[1])
    where = outcome if next_action_at == "outcome" else perturbed
    if fixed_next_action is not None:
        then = fixed_next_action
    elif next_action == "sample":
        then, _ = act(next_actor, where, noise[2])
    else:
        then = mode(next_actor, where)
    return spread(q_values(critics, outcome, then), ddof)


def worst_of_draws(states, offsets, noises, u, reduce="max") -> np.ndarray:
    """The largest (or the mean) of u(s + offset_i, noise_i) over the draws, for every state."""
    values = np.stack([u(numbers(states) + numbers(o), n) for o, n in zip(offsets, noises, strict=True)])
    return values.max(axis=0) if reduce == "max" else values.mean(axis=0)


def ascend(states, noise, u, radius: float, steps: int, width: float = 1e-6) -> np.ndarray:
    """u after signed steps inside the box, its gradient taken by central differences."""
    states = numbers(states)
    offsets = np.zeros_like(states)
    length = radius if steps == 1 else 2.0 * radius / steps
    for _ in range(steps):
        slope = np.zeros_like(states)
        for dimension in range(states.shape[1]):
            nudge = np.zeros_like(states)
            nudge[:, dimension] = width
            slope[:, dimension] = u(states + offsets + nudge, noise) - u(states + offsets - nudge, noise)
        offsets = np.minimum(np.maximum(offsets + length * np.sign(slope), -radius), radius)
    return u(states + offsets, noise)
