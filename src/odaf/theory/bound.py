"""How far the learned values may be from the exact ones: the paper's main theorem, corrected and as printed.

Corrected, with probability 1 - delta over the log, in sup norm and with n(s,a) rows of each pair:

    |Q_hat^k - Q*|_inf <= gamma V_max / (1 - gamma) max_(s,a) e(n(s,a)) + gamma^k |Q_hat^0 - Q_hat*|_inf
    e(n) = min(2, sqrt(2/n log(|S| |A| 2^|S| / delta))), V_max = R_max / (1 - gamma)

The first term is |Q_hat* - Q*| <= |T_hat Q* - T Q*| / (1 - gamma) with |P_hat - P|_1 <= e (Weissman et al. 2003, a
union over pairs), by Hoelder's inequality; the second is the contraction. As printed, for each pair by itself:

    |Q_hat^k - Q*|(s,a) <= gamma R_max / (1 - gamma) sqrt(2 / (N d(s,a)) log(|S| |A| 2^|S| / delta))
                           + gamma^k eps |Delta_0|

That has R_max where values reach V_max, an expected count for a count, the pair (s,a) where the errors of all pairs
that follow it come in, and a second term that needs an eps < 1 which cannot be (`odaf.theory.concentrability`). What
holds for each pair is that its error is at most the value of the errors that follow it:

    |Q_hat* - Q*| <= E, E(s,a) = e(s,a) + gamma sum_s' P_hat(s'|s,a) max_{a' in Pi(s')} E(s',a')
    e(s,a) = gamma |sum_s' (P_hat - P)(s'|s,a) max_{a' in Pi(s')} Q*(s',a')|
"""

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from odaf.theory.mdp import TabularMDP
from odaf.theory.operator import backup, fixed_point


def l1_radius(
    counts: Shaped[np.ndarray, "*shape"], states: int, pairs: int, delta: float
) -> Float[np.ndarray, "*shape"]:
    """e(n): with probability 1 - delta no pair's |P_hat - P|_1 is larger; 2, which none exceeds, where n is 0.

    Args:
        counts: n, rows of each pair.
        states: |S|, how many.
        pairs: |S| |A|, how many.
        delta: the share of logs for which it may fail.
    """
    logarithm = np.log(pairs / delta) + states * np.log(2.0)
    with np.errstate(divide="ignore"):
        return np.minimum(2.0, np.sqrt(2.0 * logarithm / counts))


def error_bound(
    counts: Int[np.ndarray, "draws states actions"], mdp: TabularMDP, delta: float
) -> Float[np.ndarray, " draws"]:
    """The corrected bound's first term, gamma V_max / (1 - gamma) max_(s,a) e(n(s,a)); one a log."""
    states, actions = mdp.rewards.shape
    radius = l1_radius(counts, states, states * actions, delta)
    return mdp.discount * mdp.largest_value / (1.0 - mdp.discount) * radius.max((-2, -1))


def iteration_error(
    k: int,
    start: Float[np.ndarray, "draws states actions"],
    limit: Float[np.ndarray, "*limits states actions"],
    discount: float,
) -> Float[np.ndarray, " draws"]:
    """The corrected bound's second term, gamma^k |Q_hat^0 - Q_hat*|_inf; one a start."""
    return discount**k * np.abs(start - limit).max((-2, -1))


def printed_bound(
    rows: int, pairs: Float[np.ndarray, "states actions"], mdp: TabularMDP, delta: float, largest: float | None = None
) -> Float[np.ndarray, "states actions"]:
    """The printed bound's first term, a number for each pair.

    Args:
        rows: N.
        pairs: d(s,a).
        mdp: the problem.
        delta: as in the corrected bound.
        largest: what stands in the place of R_max; the largest reward if it is not given.
    """
    states, actions = mdp.rewards.shape
    logarithm = np.log(states * actions / delta) + states * np.log(2.0)
    most = float(mdp.rewards.max()) if largest is None else largest
    return mdp.discount * most / (1.0 - mdp.discount) * np.sqrt(2.0 / (rows * pairs) * logarithm)


def local_errors(
    exact: Float[np.ndarray, "states actions"],
    mdp: TabularMDP,
    learned: TabularMDP,
    allowed: Bool[np.ndarray, "states actions"],
) -> Float[np.ndarray, "draws states actions"]:
    """e(s,a) = |T_hat Q* - T Q*|(s,a), what one backup of the exact values is off by; one table a log."""
    return np.abs(backup(exact, learned, allowed) - backup(exact, mdp, allowed))


def propagated_errors(
    local: Float[np.ndarray, "draws states actions"], learned: TabularMDP, allowed: Bool[np.ndarray, "states actions"]
) -> Float[np.ndarray, "draws states actions"]:
    """E(s,a), the largest discounted sum of local errors along what follows a pair: the local errors as rewards."""
    return fixed_point(TabularMDP(learned.transitions, local, learned.discount), allowed)
