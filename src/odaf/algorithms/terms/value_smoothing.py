"""RORL's term on the critics: values should change little in a small box around a state, and rise least of all.

    D_k(i) = Q_k(s + delta_i, a) - Q_k(s, a),   delta_i uniform in the box
    l(i)   = mean_k [ (1 - f) max(D_k, 0)^2 + f min(D_k, 0)^2 ],   f = fall_weight
    L_S    = weight * mean_B max_i l(i)

The gradient goes into both values (Yang et al. 2022). docs/reference/algorithms/rorl.md tells what differs from the
paper.
"""

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics
from odaf.algorithms.terms.base import Context, Term
from odaf.components.perturbations import draw_offsets, worst_offsets
from odaf.components.targets import frozen
from odaf.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class ValueSmoothing(Term):
    """Keep the critics from changing, above all from rising, inside a small box around each state (RORL)."""

    name: ClassVar[str] = "value_smoothing"
    acts_on_critics: ClassVar[bool] = True

    weight: float = 1e-4
    """beta_Q, the weight in the critics' loss (RORL 0.0001); 0 leaves the term out."""
    radius: float = 0.005
    """epsilon_Q, half the edge of the box around a state, in standard deviations of the log."""
    num_draws: int = 20
    """Draws a state, of which the worst counts."""
    shared_draws: bool = False
    """One set of offsets for the whole batch, as in RORL's code."""
    fall_weight: float = 0.2
    """tau: squares of values that fall inside the box count so much, of values that rise 1 minus this."""

    def citations(self) -> tuple[citations.Citation, ...]:
        """RORL."""
        return (citations.RORL,)

    def __post_init__(self) -> None:
        if self.num_draws < 1 or self.radius < 0 or self.weight < 0 or not 0.0 <= self.fall_weight <= 1.0:
            raise ConfigError(
                f"value_smoothing: num_draws={self.num_draws} must be at least 1; weight={self.weight} and "
                f"radius={self.radius} must not be negative; fall_weight={self.fall_weight} must lie in [0, 1]"
            )

    def critic_loss(self, context: Context, state: PyTree, key: PRNGKeyArray) -> tuple[Float[Array, ""], Metrics]:
        """weight * mean of the worst l; its gradient reaches the critics only."""
        del state
        states, actions = context.batch.observations, context.batch.actions
        rows, obs_dim = states.shape
        offsets = draw_offsets(
            key, self.num_draws, rows, obs_dim, self.radius, shared=self.shared_draws, include_centre=False
        )
        fixed = frozen(context.critics)
        fixed_values = fixed(states, actions)
        worst = worst_offsets(lambda offset: self.change(fixed_values, fixed(states + offset, actions)), offsets)
        change = self.change(context.critics(states, actions), context.critics(states + worst, actions))
        loss = jnp.mean(change)
        return self.weight * loss, {"value_smoothing/loss": loss, "value_smoothing/max": jnp.max(change)}

    def change(
        self, values: Float[Array, "critics rows"], perturbed: Float[Array, "critics rows"]
    ) -> Float[Array, " rows"]:
        """l: mean over members of the squared change, rises weighted 1 - fall_weight and falls fall_weight."""
        rise = perturbed - values
        weights = jnp.where(rise > 0.0, 1.0 - self.fall_weight, self.fall_weight)
        return jnp.mean(weights * jnp.square(rise), axis=0)
