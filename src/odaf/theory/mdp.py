"""Finite Markov decision problems, drawn at random or given, and exact values of policies in them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int


@dataclass(frozen=True, eq=False)
class TabularMDP:
    """A decision problem with known tables. Leading axes, if there are any, hold one problem each.

    Attributes:
        transitions: P(s'|s,a), the successor's axis last.
        rewards: r(s,a), expected; one table, or one for each problem.
        discount: gamma, below 1.
    """

    transitions: Float[np.ndarray, "*draws states actions states"]
    rewards: Float[np.ndarray, "*#draws states actions"]
    discount: float

    @property
    def largest_value(self) -> float:
        """V_max = R_max / (1 - gamma), a bound on sums of discounted rewards where no reward is negative."""
        return float(self.rewards.max()) / (1.0 - self.discount)


def random_mdp(
    rng: np.random.Generator,
    states: int = 20,
    actions: int = 4,
    discount: float = 0.9,
    concentration: float = 0.05,
    smallest: float = 0.01,
) -> TabularMDP:
    """Sparse Dirichlet transitions, and rewards uniform in [0, 1].

    A Dirichlet draw is positive everywhere, so that nothing would lie outside its support: probabilities below
    `smallest` are set to 0 and the others scaled to sum to 1.
    """
    drawn = rng.dirichlet(np.full(states, concentration), size=(states, actions))
    drawn[drawn < smallest] = 0.0
    return TabularMDP(drawn / drawn.sum(-1, keepdims=True), rng.uniform(size=(states, actions)), discount)


def random_support(rng: np.random.Generator, states: int, share: float) -> Bool[np.ndarray, " states"]:
    """A random `share` of the states: where the data are, supp(d^beta)."""
    support = np.zeros(states, bool)
    support[rng.permutation(states)[: round(share * states)]] = True
    return support


def policy_values(mdp: TabularMDP, policy: Int[np.ndarray, "*draws states"]) -> Float[np.ndarray, "*draws states"]:
    """V^pi of deterministic policies, solved: V = (I - gamma P_pi)^-1 r_pi.

    Args:
        mdp: one problem.
        policy: the action in each state; one policy a draw.
    """
    each = np.arange(mdp.rewards.shape[0])
    moves, rewards = mdp.transitions[each, policy], mdp.rewards[each, policy]
    return np.linalg.solve(np.eye(len(each)) - mdp.discount * moves, rewards[..., None])[..., 0]


def state_distribution(
    mdp: TabularMDP, policy: Float[np.ndarray, "states actions"], start: Float[np.ndarray, " states"]
) -> Float[np.ndarray, " states"]:
    """d^pi(s) = (1 - gamma) sum_t gamma^t Pr(s_t = s), the discounted state distribution; it sums to 1.

    Args:
        mdp: one problem.
        policy: probabilities of actions.
        start: rho_0.
    """
    moves = np.einsum("sa,saz->sz", policy, mdp.transitions)
    return (1.0 - mdp.discount) * np.linalg.solve(np.eye(len(start)) - mdp.discount * moves.T, start)


def uniform_policy(mdp: TabularMDP) -> Float[np.ndarray, "states actions"]:
    """Every action with equal probability."""
    return np.full(mdp.rewards.shape, 1.0 / mdp.rewards.shape[1])
