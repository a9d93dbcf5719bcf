"""What a term is given and what it gives back."""

import abc
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms.base import Metrics, PretrainProgress
from odaf.components.critics import CriticEnsemble
from odaf.components.policies import GaussianActor
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions


class Context(eqx.Module):
    """What the learner knows while it computes one loss."""

    batch: Transitions
    actor: GaussianActor
    slow_actor: GaussianActor
    critics: CriticEnsemble
    target_critics: CriticEnsemble
    value_bounds: Float[Array, "2"]  # smallest and largest target; infinite when targets are not clipped
    step: Int[Array, ""]
    memory: PyTree = ()  # what the term that is asked remembers; see `Term.first_memory`


class Term(abc.ABC):
    """An addition to the actor loss, to the critic loss, or to both: a frozen dataclass.

    A term owns its hyper-parameters, its side network (if any) and its metrics. Its weight is applied inside. A term of
    weight 0 is left out of training altogether, so it costs nothing and changes nothing.
    """

    name: ClassVar[str]
    acts_on_actor: ClassVar[bool] = False
    acts_on_critics: ClassVar[bool] = False
    needs_next_state: ClassVar[bool] = False  # reads s' as the state after one step, so targets must span one step
    weight: float

    def untrained_side(self, key: PRNGKeyArray, spec: Spec) -> PyTree:
        """Side network before pre-training; () when the term has none."""
        del key, spec
        return ()

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[PyTree, dict[str, Any]]:
        """Train the side network; the report's entry "warnings" lists sentences for the user."""
        del dataset, normaliser, key, progress
        return (), {"warnings": []}

    def first_memory(self) -> PyTree:
        """What the term remembers from update to update, before the first one; () when that is nothing."""
        return ()

    def next_memory(self, memory: PyTree, step: Int[Array, ""], metrics: Metrics) -> PyTree:
        """The memory after an update.

        Args:
            memory: the memory that the update saw.
            step: updates made, this one included.
            metrics: the term's own metrics of this update, among others.
        """
        del step, metrics
        return memory

    def actor_loss(self, context: Context, side: PyTree, key: PRNGKeyArray) -> tuple[Float[Array, ""], Metrics]:
        """Weighted addition to the actor's loss. Gradients must reach `context.actor` only."""
        del context, side, key
        return jnp.zeros(()), {}

    def critic_loss(self, context: Context, side: PyTree, key: PRNGKeyArray) -> tuple[Float[Array, ""], Metrics]:
        """Weighted addition to the critics' loss. Gradients must reach `context.critics` only."""
        del context, side, key
        return jnp.zeros(()), {}
