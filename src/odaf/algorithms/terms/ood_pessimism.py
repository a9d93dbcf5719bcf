"""Pessimism on the policy's own actions: pull each critic at (s^, a ~ pi) below itself by its ensemble's disagreement.

    L_ood = weight * mean_{k, rows, draws} ( Q_k(s^, a^) - sg[ Q_k(s^, a^) - lambda_t std_k Q_k(s^, a^) ] )^2

RORL perturbs the states and uses one lambda_t that decays; PBRL uses the states and the next states as they are, a
constant lambda at the next states, and floors the targets at 0. Both are settings of this one term.

PBRL's code also eases lambda_t once it has stopped decaying (`adaptive`): the mean of Q at the policy's actions is
recorded every 1,000 updates, and where the last 5 records lie below the 15 before them on average, lambda_t is divided
by 1.01 from then on, as long as it is above 0.2.
"""

import dataclasses
import functools
from typing import Any, ClassVar, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics
from odaf.algorithms.terms.base import Context, Term
from odaf.components.chunks import draws_at_once, mean_over_chunks
from odaf.components.critics import CriticEnsemble, disagreement
from odaf.components.perturbations import draw_offsets
from odaf.components.targets import frozen
from odaf.errors import ConfigError

EPOCH = 1000  # updates a record
RECORDS, RECENT = 20, 5
EASING, LEAST_DEVIATIONS = 1.01, 0.2


class Easing(eqx.Module):
    """What `adaptive` remembers."""

    factor: Float[Array, ""]  # on lambda_t
    records: Float[Array, " records"]  # newest last
    count: Int[Array, ""]  # records made
    total: Float[Array, ""]  # of the values since the last record


@dataclasses.dataclass(frozen=True)
class OODPessimism(Term):
    """Lower the critics where the policy acts and the ensemble disagrees (PBRL, RORL)."""

    name: ClassVar[str] = "ood"
    acts_on_critics: ClassVar[bool] = True

    weight: float = 0.5
    """Weight in the critics' loss; 0 leaves the term out."""
    num_actions: int = 1
    """Policy actions a state (RORL 20, PBRL 10); the loss is a mean, so this changes noise and cost, not scale."""
    radius: float = 0.0
    """Half the edge of the box that states are perturbed in before the policy acts (RORL 0.01, PBRL 0)."""
    shared_draws: bool = False
    """One set of offsets for the whole batch, as in RORL's code."""
    deviations: float = 1.0
    """lambda at step 0: how many standard deviations the targets lie below the critics."""
    final_deviations: float = 1.0
    """lambda after decay_steps."""
    decay_steps: int = 0
    """Updates over which lambda goes linearly from deviations to final_deviations; 0 keeps it constant."""
    adaptive: bool = False
    """Ease lambda after decay_steps where the policy's values fall (PBRL on all but expert and medium-expert data)."""
    next_deviations: float | None = None
    """lambda for policy actions at the next states (PBRL 0.1); None leaves the next states out (RORL)."""
    floor: float | None = None
    """Lower bound of the targets (PBRL 0); the learner's value range bounds them as well."""
    std_ddof: Literal[0, 1] = 0
    """0 divides the variance by K, 1 by K - 1 (both authors' codes)."""

    @property
    def can_be_padded(self) -> bool:
        """Yes: offsets and actions are drawn for a lane's own dimensions."""
        return True

    def citations(self) -> tuple[citations.Citation, ...]:
        """PBRL, and RORL where states are perturbed."""
        return (citations.PBRL,) if self.radius == 0.0 else (citations.PBRL, citations.RORL)

    def __post_init__(self) -> None:
        if self.num_actions < 1 or self.decay_steps < 0 or self.radius < 0 or self.weight < 0:
            raise ConfigError(
                f"ood: num_actions={self.num_actions} must be at least 1; weight={self.weight}, radius={self.radius} "
                f"and decay_steps={self.decay_steps} must not be negative"
            )

    def deviations_at(self, step: Int[Array, ""]) -> Float[Array, ""]:
        """lambda_t: linear decay that stops at its final value."""
        if self.decay_steps == 0:
            return jnp.asarray(self.deviations)
        share = jnp.minimum(step / self.decay_steps, 1.0)
        return self.deviations + (self.final_deviations - self.deviations) * share

    def init(self, model: PyTree) -> Easing | tuple[()]:
        """No easing and no records yet."""
        del model
        if not self.adaptive:
            return ()
        return Easing(jnp.ones(()), jnp.zeros(RECORDS), jnp.zeros((), jnp.int32), jnp.zeros(()))

    def next_state(self, state: Any, step: Int[Array, ""], metrics: Metrics) -> Any:
        """Adds this update's value; after a whole epoch makes a record and eases lambda where values fall."""
        if not self.adaptive:
            return ()
        total = state.total + metrics["ood/value"]
        ends = step % EPOCH == 0
        records = jnp.where(ends, jnp.append(state.records[1:], total / EPOCH), state.records)
        count = state.count + ends.astype(state.count.dtype)
        falls = jnp.mean(records[-RECENT:]) < jnp.mean(records[:-RECENT])
        high = state.factor * self.deviations_at(step) > LEAST_DEVIATIONS
        eases = ends & (step > self.decay_steps) & (count >= RECORDS) & falls & high
        factor = jnp.where(eases, state.factor / EASING, state.factor)
        return Easing(factor, records, count, jnp.where(ends, 0.0, total))

    def critic_loss(self, context: Context, state: PyTree, key: PRNGKeyArray) -> tuple[Float[Array, ""], Metrics]:
        """weight * mean squared distance to the lowered targets; its gradient reaches the critics only."""
        key_here, key_next = jr.split(key)
        weight_here = self.deviations_at(context.step)
        if self.adaptive:
            weight_here = state.factor * weight_here
        loss, spread, value = self._pull_down(context, context.batch.observations, weight_here, key_here)
        metrics = {"ood/uncertainty": spread, "ood/value": value, "ood/deviations": weight_here}
        if self.next_deviations is not None:  # a mean over twice the rows
            weight_next = jnp.asarray(self.next_deviations)
            loss_next, _, _ = self._pull_down(context, context.batch.next_observations, weight_next, key_next)
            loss = 0.5 * (loss + loss_next)
        return self.weight * loss, {"ood/loss": loss, **metrics}

    def _pull_down(
        self, context: Context, states: Float[Array, "rows obs_dim"], deviations: Float[Array, ""], key: PRNGKeyArray
    ) -> tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]:
        rows, obs_dim = states.shape
        draws = self.num_actions
        key_offsets, key_actions = jr.split(key)
        offsets = draw_offsets(
            key_offsets,
            draws,
            rows,
            obs_dim,
            self.radius,
            shared=self.shared_draws,
            include_centre=False,
            padding=context.batch.padding,
        )
        perturbed = (states[None] + offsets).reshape(draws * rows, obs_dim)
        noise = context.batch.action_noise(key_actions, draws * rows)
        actions, _ = frozen(context.actor).sample(perturbed, noise, context.batch.own_actions)

        count = draws // draws_at_once(draws, rows)
        parts = jax.tree.map(lambda column: column.reshape(count, -1, column.shape[-1]), (perturbed, actions))
        floor = jnp.asarray(-jnp.inf if self.floor is None else self.floor)
        constants = deviations, context.value_bounds, floor
        found: Any = mean_over_chunks(_pull_down_by[self.std_ddof], context.critics, parts, constants)
        loss, (spread, value) = found
        return loss, spread, value


def _part_loss(
    std_ddof: int,
    critics: CriticEnsemble,
    part: tuple[Float[Array, "rows obs_dim"], Float[Array, "rows act_dim"]],
    constants: tuple[Float[Array, ""], Float[Array, "2"], Float[Array, ""]],
) -> tuple[Float[Array, ""], tuple[Float[Array, ""], Float[Array, ""]]]:
    """Loss of a part of the rows, and the means of U and of Q over it; constants: lambda, value bounds and floor."""
    deviations, bounds, floor = constants
    values = critics(*part)
    spread = disagreement(values, std_ddof)
    targets = jnp.clip(values - deviations * spread[None, :], bounds[0], bounds[1])
    targets = jnp.maximum(targets, floor)
    loss = jnp.mean(jnp.square(values - jax.lax.stop_gradient(targets)))
    return loss, (jnp.mean(spread), jnp.mean(values))


# One function object for each divisor: what is differentiated must hold no arrays, and equal calls share their traces.
_pull_down_by = {ddof: functools.partial(_part_loss, ddof) for ddof in (0, 1)}
