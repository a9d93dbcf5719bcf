"""The outcome-driven Bellman operator on tables, equation (support_bellman) of the paper, and its fixed point.

    (T^Pi Q)(s,a) = r(s,a) + gamma sum_s' P(s'|s,a) max_{pi in Pi} E_{a'~pi(.|s')} Q(s',a')

With the empirical transitions of a log in place of P it is the paper's operator with a hat. Pi comes as a table of
allowed actions (`odaf.theory.candidates`); the maximum over the policies that mix them is that over the actions.

Differs from the paper: Q is defined there with a factor (1 - gamma) and the operator is written without it. This is the
operator as written, so values reach V_max = R_max / (1 - gamma), not R_max.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from odaf.theory.mdp import TabularMDP


def state_values(
    q: Float[np.ndarray, "*draws states actions"], allowed: Bool[np.ndarray, "states actions"]
) -> Float[np.ndarray, "*draws states"]:
    """max_{pi in Pi} E_{a~pi} Q(s,a): the largest value of an allowed action."""
    return np.where(allowed, q, -np.inf).max(-1)


def backup(
    q: Float[np.ndarray, "*values states actions"], mdp: TabularMDP, allowed: Bool[np.ndarray, "states actions"]
) -> Float[np.ndarray, "*draws states actions"]:
    """T^Pi Q. One Q may meet the transitions of many draws, and many Q one problem."""
    values = state_values(q, allowed)[..., None, :, None]
    return mdp.rewards + mdp.discount * (mdp.transitions @ values)[..., 0]


def iterate(
    q: Float[np.ndarray, "*draws states actions"], mdp: TabularMDP, allowed: Bool[np.ndarray, "states actions"], k: int
) -> Float[np.ndarray, "*draws states actions"]:
    """(T^Pi)^k Q."""
    for _ in range(k):
        q = backup(q, mdp, allowed)
    return q


def fixed_point(
    mdp: TabularMDP,
    allowed: Bool[np.ndarray, "states actions"],
    start: Float[np.ndarray, "*draws states actions"] | None = None,
    tolerance: float = 1e-10,
) -> Float[np.ndarray, "*draws states actions"]:
    """Q* = T^Pi Q*, to `tolerance` in sup norm, by iteration from `start` (zeros)."""
    q = np.zeros(mdp.transitions.shape[:-1]) if start is None else start
    while True:
        after = backup(q, mdp, allowed)
        # The rest of the way is at most gamma / (1 - gamma) of the last step, by the contraction.
        if np.abs(after - q).max() * mdp.discount <= tolerance * (1.0 - mdp.discount):
            return after
        q = after


def greedy(
    q: Float[np.ndarray, "*draws states actions"], allowed: Bool[np.ndarray, "states actions"]
) -> Int[np.ndarray, "*draws states"]:
    """The allowed action with the largest value, the first of several."""
    return np.where(allowed, q, -np.inf).argmax(-1)
