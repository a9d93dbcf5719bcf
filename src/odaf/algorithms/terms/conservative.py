"""CQL's penalty as a term (CQL(H), Kumar et al. 2020): the critics' soft maximum over actions comes down.

    L_c = weight * sum_k mean_B ( log sum_i exp( Q_k(s, a_i) - log p_i ) - Q_k(s, a) )

`odaf.components.conservative` says which actions a_i these are. The term is what CQL's relatives put beside terms of
their own (OSR, SDC); CQL itself, with its other parts, is `odaf.algorithms.cql`.
"""

import dataclasses
from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics
from odaf.algorithms.terms.base import Context, Term
from odaf.components.chunks import mean_over_chunks
from odaf.components.conservative import Candidates, draw_candidates, values_and_gaps
from odaf.components.critics import CriticEnsemble, over_members
from odaf.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class Conservative(Term):
    """Lower the critics over all actions and raise them at the logged ones (CQL)."""

    name: ClassVar[str] = "conservative"
    acts_on_critics: ClassVar[bool] = True

    weight: float = 5.0
    """Weight in each critic's loss (CQL 5 or 10); 0 leaves the term out."""
    num_actions: int = 10
    """n: uniform actions, and policy actions of either kind, a state."""

    def citations(self) -> tuple[citations.Citation, ...]:
        """CQL."""
        return (citations.CQL,)

    def __post_init__(self) -> None:
        if self.num_actions < 1 or self.weight < 0:
            raise ConfigError(
                f"conservative: num_actions={self.num_actions} must be at least 1 and weight={self.weight} "
                "must not be negative"
            )

    def critic_loss(self, context: Context, state: PyTree, key: PRNGKeyArray) -> tuple[Float[Array, ""], Metrics]:
        """weight * sum over critics of the mean gap; its gradient reaches the critics only."""
        del state
        candidates = draw_candidates(key, context.actor, context.batch, self.num_actions).in_chunks()

        def mean(critic: CriticEnsemble) -> Float[Array, ""]:
            found: Any = mean_over_chunks(_mean_gap, critic, candidates, ())
            return found[0]

        gaps = over_members(mean, context.critics)
        return self.weight * jnp.sum(gaps), {"conservative/gap": jnp.mean(gaps)}


def _mean_gap(
    critic: CriticEnsemble, candidates: Candidates, constants: tuple[()]
) -> tuple[Float[Array, ""], tuple[()]]:
    return jnp.mean(values_and_gaps(critic, candidates)[1]), constants
