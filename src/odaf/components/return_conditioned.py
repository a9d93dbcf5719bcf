"""A policy that is asked for a return: it acts by what is still to be earned, and counts what it has earned."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.components.networks import MLP
from odaf.components.policies import Actor


class ReturnConditionedActor(Actor):
    """clip( MLP(s, (g - mean) / std), -1, 1 ), with g the return asked for less the rewards that were earned.

    Rewards count as they are, without a discount. The carry is g, one number an episode.
    """

    takes_rewards: ClassVar[bool] = True

    network: MLP  # of s and g; its output is linear
    start: Float[Array, ""]  # g before the first step, in the units of the rewards
    mean: Float[Array, ""]
    std: Float[Array, ""]

    def actions(
        self, observations: Float[Array, "rows obs_dim"], returns_to_go: Float[Array, " rows"]
    ) -> Float[Array, "rows act_dim"]:
        """What the network gives, not cut to [-1, 1]."""
        asked = (returns_to_go - self.mean) / self.std
        return self.network(jnp.concatenate([observations, asked[:, None]], axis=-1))

    def begin(self, rows: int) -> PyTree:
        """The return that is asked for, once an episode."""
        return jnp.broadcast_to(self.start, (rows,))

    def act(
        self, carry: PyTree, observations: Float[Array, "rows obs_dim"], key: PRNGKeyArray | None = None
    ) -> tuple[Float[Array, "rows act_dim"], PyTree]:
        """The network's actions cut to [-1, 1], with or without a key."""
        del key
        return jnp.clip(self.actions(observations, carry), -1.0, 1.0), carry

    def observe(self, carry: PyTree, rewards: Float[Array, " rows"]) -> PyTree:
        """g less the rewards."""
        return carry - rewards
