"""The contract between a learner and the loop that trains it."""

import abc
from collections.abc import Callable
from typing import Any, ClassVar, Generic, TypeVar

import equinox as eqx
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.components.critics import CriticEnsemble
from odaf.components.policies import Actor
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions

Metrics = dict[str, Float[Array, ""]]
PretrainProgress = Callable[[str, int, int], None]


class LearnerState(eqx.Module):
    """Everything that changes while a learner trains; a pytree of arrays."""

    step: eqx.AbstractVar[Int[Array, ""]]


State = TypeVar("State", bound=LearnerState)


class Algorithm(abc.ABC, Generic[State]):
    """A learner's settings (a frozen dataclass) and its pure functions.

    The loop calls, in this order: `untrained_side`, `pretrain`, `init`, then `update` inside compiled stretches, and
    `actor` for evaluation. Observations are normalised and actions scaled to [-1, 1] everywhere in here.
    """

    kind: ClassVar[str]
    discount: float
    batch_size: int
    return_steps: int = 1  # n: a row of a batch spans n steps, and its reward is the discounted sum over them

    @abc.abstractmethod
    def untrained_side(self, key: PRNGKeyArray, spec: Spec) -> PyTree:
        """Side networks before pre-training, in the structure that `pretrain` returns; () when there are none."""

    @abc.abstractmethod
    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[PyTree, dict[str, Any]]:
        """Train the side networks on the log.

        Args:
            dataset: the log, in the user's units.
            normaliser: the observation scaling that training will use.
            key: random key.
            progress: called with (stage, steps done, steps in all).

        Returns:
            The side networks and a JSON-able report, whose entry "warnings" lists sentences for the user.
        """

    @abc.abstractmethod
    def init(self, key: PRNGKeyArray, spec: Spec, side: PyTree) -> State:
        """State at step 0 around given side networks."""

    @abc.abstractmethod
    def update(self, state: State, batch: Transitions, key: PRNGKeyArray) -> tuple[State, Metrics]:
        """One gradient step on one batch. Pure and traceable; metric names are the same at every step."""

    @abc.abstractmethod
    def actor(self, state: State) -> Actor:
        """What the trained policy is: all that is needed to act, and nothing else. May be traced."""

    def values(self, state: State) -> CriticEnsemble | None:
        """Q_k(s, a) of the rewards that the learner trains on, for attacks and guards; None without critics.

        May be traced.
        """
        del state
        return None
