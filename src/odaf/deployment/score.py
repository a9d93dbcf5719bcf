"""How far the action about to be taken leads from what the log knows: one number, made of four.

With z the normalised observation, a the action in [-1, 1], f the dynamics, mu the policy and Q_k the critics,

    range          max_i | o_i - c_i | / h_i                    c_i, h_i: middle and half width of the log's column i
    distance       min_m | W (z, a) - x_m |                     x_m: rows of the log, see `odaf.deployment.nearest`
    disagreement   std_k Q_k( z', mu(z') ),   z' = f(z, a)      ODAF's own quantity, at the predicted outcome
    surprise       | R ( z - f(z-, a-) ) |                      z-, a- of the step before; 0 in a first step

    R^T R = ( C + e I )^-1,   C the covariance of that error in the log

    score = max_j part_j / level_j

W and R are symmetric, which keeps whitened coordinates as near as can be to the columns they come from, so that the
squares of these coordinates, whose sum a part is the root of, say which column it owes most to.

A part's level is what it exceeds in a share alpha of the log's episodes, so that 1 means the same of each. Surprise is
the one part that sees what an observation does not show: a push, or a sensor that lies while its readings look like the
log's. A reading that is not finite makes the score NaN, and `score <= threshold` false, which is an alarm.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from odaf.components.critics import CriticEnsemble, disagreement
from odaf.components.dynamics import DynamicsModel
from odaf.components.policies import Actor

PARTS = ("range", "distance", "disagreement", "surprise")
MISSING = len(PARTS)  # the part of an alarm for a reading that is not finite
NO_COLUMN = -1


class Judgement(eqx.Module):
    """What is said of rows.

    `column` counts observations and then actions, and is that which the largest part owes most to; the disagreement of
    critics owes nothing to one column.
    """

    score: Float[Array, " rows"]
    parts: Float[Array, "rows parts"]  # each beside its level
    part: Int[Array, " rows"]  # the largest
    column: Int[Array, " rows"]
    state: Float[Array, "rows obs_dim"]  # z


class GuardScore(eqx.Module):
    """What the score is computed from. Observations come in the log's units, actions in [-1, 1]."""

    outcome: DynamicsModel
    critics: CriticEnsemble
    mean: Float[Array, " obs_dim"]
    inverse_scale: Float[Array, " obs_dim"]  # 0 in columns that never varied
    centre: Float[Array, " obs_dim"]
    half_width: Float[Array, " obs_dim"]
    whitening: Float[Array, "width width"]  # W, symmetric
    points: Float[Array, "references width"]  # x_m
    error_whitening: Float[Array, "obs_dim obs_dim"]  # R, symmetric
    levels: Float[Array, " parts"]

    def normalised(self, observations: Float[Array, "rows obs_dim"]) -> Float[Array, "rows obs_dim"]:
        """z."""
        return (observations - self.mean[None]) * self.inverse_scale[None]

    def place(
        self, states: Float[Array, "rows obs_dim"], actions: Float[Array, "rows act_dim"]
    ) -> Float[Array, "rows width"]:
        """W (z, a)."""
        return jnp.concatenate([states, actions], axis=-1) @ self.whitening

    def judge(
        self,
        actor: Actor,
        observations: Float[Array, "rows obs_dim"],
        actions: Float[Array, "rows act_dim"],
        before: tuple[Float[Array, "rows obs_dim"], Float[Array, "rows act_dim"]],
    ) -> Judgement:
        """The score of each row.

        Args:
            actor: mu, on normalised observations.
            observations: o.
            actions: a.
            before: z- and a-; NaN where there is no step before, or nobody knows what was there.
        """
        expected = self.outcome.expected(*before)
        states = self.normalised(observations)
        beyond = jnp.abs(observations - self.centre[None]) / self.half_width[None]
        outcome = self.outcome.expected(states, actions)
        values = self.critics(outcome, actor.mode(outcome))
        distance, gaps = self._nearest(self.place(states, actions))
        known = jnp.all(jnp.isfinite(jnp.concatenate(before, axis=-1)), axis=-1)
        error = jnp.where(known[:, None], states - expected, jnp.zeros_like(states))
        white_error = error @ self.error_whitening
        parts = jnp.stack(
            [jnp.max(beyond, axis=-1), distance, disagreement(values), jnp.sqrt(_squares(white_error))], axis=-1
        )
        beside = parts / self.levels[None]
        part = jnp.argmax(beside, axis=-1)
        blank = jnp.zeros_like(actions)
        shares = jnp.stack(
            [
                jnp.concatenate([beyond, blank], axis=-1),
                jnp.square(gaps),
                jnp.zeros((states.shape[0], states.shape[1] + actions.shape[1]), states.dtype),
                jnp.concatenate([jnp.square(white_error), blank], axis=-1),
            ],
            axis=1,
        )
        own = jnp.take_along_axis(shares, part[:, None, None], axis=1)[:, 0]
        column = jnp.where(jnp.max(own, axis=-1) > 0.0, jnp.argmax(own, axis=-1), NO_COLUMN)
        return Judgement(jnp.max(beside, axis=-1), beside, part, column, states)

    def _nearest(self, places: Float[Array, "rows width"]) -> tuple[Float[Array, " rows"], Float[Array, "rows width"]]:
        """Distance to the nearest reference, and the way to it.

        Which is the nearest is told from | x_m |^2 - 2 x x_m, one product for all rows; the distance is then that of
        the difference, since the expanded square loses its digits where it is small.
        """
        squares = _squares(self.points)[None] - 2.0 * places @ self.points.T
        gaps = places - self.points[jnp.argmin(squares, axis=1)]
        return jnp.sqrt(_squares(gaps)), gaps


def alarms(score: Float[Array, " rows"], threshold: Float[Array, ""]) -> Bool[Array, " rows"]:
    """Whether the score is above the threshold, or no number."""
    return ~(score <= threshold)


def _squares(rows: Float[Array, "rows width"]) -> Float[Array, " rows"]:
    return jnp.sum(jnp.square(rows), axis=-1)
