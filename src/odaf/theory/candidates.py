"""Candidate sets of policies, as tables of the actions that they may take.

Outcome-driven: Pi = {pi | for all s: supp P(.|s,pi) within supp d^beta}, equation (d_support_set) of the paper. The
support of P(.|s,pi) is the union of the supports of the actions that pi takes, so a policy is in Pi exactly if each of
its actions keeps within the support: Pi is a product over states, and the maximum over it is taken state by state.

Action-supported: Pi_ac = {pi | for all s: supp pi(.|s) within supp pi_beta(.|s)}, equation (a_support_set).

Differs from the paper: Pi asks something of states in the data alone, and of a state where every action leaks it
admits no policy at all, so that the operator's maximum is over nothing. Here every state has an action: where none is
admissible, the one that leaks least.
"""

import numpy as np
from jaxtyping import Bool, Float


def leak(
    transitions: Float[np.ndarray, "states actions states"], support: Bool[np.ndarray, " states"]
) -> Float[np.ndarray, "states actions"]:
    """The mass of P(.|s,a) outside the support; exactly 0 where nothing of it is."""
    return transitions[:, :, ~support].sum(-1)


def outcome_supported(
    transitions: Float[np.ndarray, "states actions states"], support: Bool[np.ndarray, " states"]
) -> Bool[np.ndarray, "states actions"]:
    """The actions of Pi: those that leak nothing; in a state without any, the one that leaks least."""
    return _with_fallback(leak(transitions, support) == 0.0, transitions, support)


def action_supported(
    logged: Bool[np.ndarray, "states actions"],
    transitions: Float[np.ndarray, "states actions states"],
    support: Bool[np.ndarray, " states"],
) -> Bool[np.ndarray, "states actions"]:
    """The actions of Pi_ac: those that the behaviour takes; in a state without any, the one that leaks least."""
    return _with_fallback(logged, transitions, support)


def _with_fallback(
    allowed: Bool[np.ndarray, "states actions"],
    transitions: Float[np.ndarray, "states actions states"],
    support: Bool[np.ndarray, " states"],
) -> Bool[np.ndarray, "states actions"]:
    empty = ~allowed.any(-1)
    filled = allowed.copy()
    filled[empty, leak(transitions, support).argmin(-1)[empty]] = True
    return filled
