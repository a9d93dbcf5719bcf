"""How much more often a policy's outcomes come than the data have them: the assumption of the main theorem.

The paper asks sup_s' P(s'|s,pi) / d(s') <= eps < 1 for all pi in Pi. Both P(.|s,pi) and d sum to 1, so

    sup_s' P(s'|s,pi) / d(s') >= sum_s' d(s') P(s'|s,pi) / d(s') = 1

and there is no such eps. What can be: a constant C >= 1 with P(s'|s,a) <= C d(s') for all pairs. It holds for any
number of steps, because the last of them alone gives it: P(s_k|s,a) = sum_s P(s|.) P(s_k|s,pi_k-1) <= C d(s_k). So

    |Q_hat^k - Q_hat*|(s,a) <= gamma^k C sum_s d(s) max_{a in Pi(s)} |Q_hat^0 - Q_hat*|(s,a)

takes the place of the printed gamma^k eps |Delta_0|, in which a factor below 1 shrank with every step.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from odaf.theory.mdp import TabularMDP


def constant(
    transitions: Float[np.ndarray, "states actions states"], distribution: Float[np.ndarray, " states"]
) -> float:
    """C = max over pairs and successors of P(s'|s,a) / d(s')."""
    return float((transitions / distribution).max())


def smallest_supremum(
    outcomes: Float[np.ndarray, "actions states"], distribution: Float[np.ndarray, " states"]
) -> float:
    """min over all policies of sup_s' P(s'|s,pi) / d(s') in one state, solved as a linear programme.

    Args:
        outcomes: P(s'|s,a) of the state's actions.
        distribution: d(s'), positive.
    """
    from scipy.optimize import linprog

    actions, states = outcomes.shape
    # Unknown are the actions' probabilities and t; t is to be small and no ratio above it.
    found = linprog(
        c=[0.0] * actions + [1.0],
        A_ub=np.column_stack([(outcomes / distribution).T, -np.ones(states)]),
        b_ub=np.zeros(states),
        A_eq=[[1.0] * actions + [0.0]],
        b_eq=[1.0],
    )
    return float(found.fun)


def outcomes_of_steps(
    mdp: TabularMDP, policies: Sequence[Float[np.ndarray, "states actions"]]
) -> list[Float[np.ndarray, "states actions states"]]:
    """P(s_k|s,a,pi_1..pi_k-1) for k = 1, 2, ...: the first step takes a, step k + 1 the k-th policy."""
    steps = [mdp.transitions]
    for policy in policies:
        steps.append(steps[-1] @ np.einsum("sa,saz->sz", policy, mdp.transitions))
    return steps


def iteration_error(
    k: int,
    difference: Float[np.ndarray, "states actions"],
    allowed: Bool[np.ndarray, "states actions"],
    distribution: Float[np.ndarray, " states"],
    c: float,
    discount: float,
) -> float:
    """gamma^k C sum_s d(s) max_{a in Pi(s)} |Q^0 - Q*|(s,a), the corrected second term by the density of the data.

    Args:
        k: iterations.
        difference: Q^0 - Q*.
        allowed: the actions of Pi.
        distribution: d(s).
        c: the constant C.
        discount: gamma.
    """
    return discount**k * c * float(distribution @ np.where(allowed, np.abs(difference), 0.0).max(-1))


def random_policy(
    rng: np.random.Generator, allowed: Bool[np.ndarray, "states actions"]
) -> Float[np.ndarray, "states actions"]:
    """Uniform among the policies that mix allowed actions."""
    weights = np.where(allowed, rng.exponential(size=allowed.shape), 0.0)
    return weights / weights.sum(-1, keepdims=True)
