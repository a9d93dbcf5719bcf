"""Logs of a finite decision problem, kept as counts, and the transitions that they show."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from odaf.theory.mdp import TabularMDP


@dataclass(frozen=True, eq=False)
class TabularLogs:
    """Logs of one problem, one a draw.

    Attributes:
        counts: n(s,a), rows of each pair.
        mdp: the problem with the empirical transitions; those of a pair without rows are uniform. Rewards are known.
    """

    counts: Int[np.ndarray, "draws states actions"]
    mdp: TabularMDP


def draw_logs(
    rng: np.random.Generator,
    mdp: TabularMDP,
    pairs: Float[np.ndarray, "states actions"],
    rows: int,
    draws: int,
) -> TabularLogs:
    """Draws logs of `rows` independent rows: n ~ multinomial(N, d), then the successors of each pair.

    Args:
        rng: where randomness comes from.
        mdp: the problem.
        pairs: d(s,a), how often the behaviour is where and does what.
        rows: N.
        draws: how many logs.
    """
    counts = rng.multinomial(rows, pairs.ravel(), size=draws).reshape(draws, *pairs.shape)
    successors = rng.multinomial(counts, mdp.transitions)
    seen = counts[..., None]
    empirical = np.where(seen > 0, successors / np.maximum(seen, 1), 1.0 / pairs.shape[0])
    return TabularLogs(counts, replace(mdp, transitions=empirical))
