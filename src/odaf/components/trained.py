"""What is trained: a network with its optimiser's moments and its slowly moving copy, which move together."""

from typing import Generic, TypeVar

import equinox as eqx
import optax
from jaxtyping import PyTree

from odaf.components.adam import adam_step, initial_moments
from odaf.components.numbers import Number
from odaf.components.targets import copy_of, polyak

Networks = TypeVar("Networks")


class Trained(eqx.Module, Generic[Networks]):
    """A network as it is now, its slow copy and Adam's moments.

    Attributes:
        now: the parameters that gradients move.
        slow: an average over the last updates, of the same structure; None where nobody needs one.
        moments: of Adam.
    """

    now: Networks
    slow: Networks | None
    moments: optax.OptState

    @classmethod
    def begin(cls, networks: Networks, *, slow: bool = True) -> "Trained[Networks]":
        """Before the first step: the slow copy equals the network, the moments are zero."""
        return cls(networks, copy_of(networks) if slow else None, initial_moments(networks))

    def stepped(
        self,
        gradient: PyTree,
        learning_rate: Number,
        slow_rate: Number | None = None,
    ) -> "Trained[Networks]":
        """After one step of Adam; the slow copy then moves `slow_rate` of the way to the new parameters.

        Args:
            gradient: of the loss, with the structure of `now`.
            learning_rate: step size.
            slow_rate: in (0, 1]; None leaves the slow copy where it is.
        """
        now, moments = adam_step(learning_rate, gradient, self.moments, self.now)
        if self.slow is None or slow_rate is None:
            return Trained(now, self.slow, moments)
        return Trained(now, polyak(self.slow, now, slow_rate), moments)
