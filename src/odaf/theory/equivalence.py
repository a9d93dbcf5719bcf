"""The outcome penalty and the mass of unseen outcomes, the two sides of the paper's equivalence theorem.

    J(pi) = sum_s' P(s'|s,pi) U^pi(s'), U^pi(s') = E_{a'~pi(.|s')} U(s',a')        (the penalty, equation cumorleq)
    M(pi) = sum_{s' not in supp d} P(s'|s,pi)                                       (the mass, equation minsupport)

With U >= U_min > 0 on unseen pairs and U >= 0 everywhere, U_min M(pi) <= J(pi). So the minimiser of J has

    M(argmin J) <= min_pi J(pi) / U_min.

That is all: the minimiser of an upper bound is not the minimiser of what it bounds. Both agree where U is 0 within the
support and constant outside of it, for then J is a multiple of M.
"""

import numpy as np
from jaxtyping import Bool, Float


def penalty(
    outcomes: Float[np.ndarray, "*problems policies states"],
    policies: Float[np.ndarray, "*problems policies states actions"],
    uncertainty: Float[np.ndarray, "*problems states actions"],
) -> Float[np.ndarray, "*problems policies"]:
    """J(pi) of each policy.

    Args:
        outcomes: P(s'|s,pi) in the one state that is decided in.
        policies: pi(a'|s'), what each policy does in its successors.
        uncertainty: U(s',a').
    """
    averaged = np.einsum("...psa,...sa->...ps", policies, uncertainty)
    return (outcomes * averaged).sum(-1)


def unseen_mass(
    outcomes: Float[np.ndarray, "*problems policies states"], support: Bool[np.ndarray, "*problems states"]
) -> Float[np.ndarray, "*problems policies"]:
    """M(pi) of each policy."""
    return np.where(support[..., None, :], 0.0, outcomes).sum(-1)
