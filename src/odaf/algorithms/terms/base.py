"""What a term is given and what it gives back."""

import abc
from collections.abc import Hashable
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms.base import Metrics, PretrainProgress
from odaf.algorithms.citations import Citation
from odaf.components.critics import CriticEnsemble
from odaf.components.policies import GaussianActor
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import Extra


class Context(eqx.Module):
    """What the learner knows while it computes one loss."""

    batch: Transitions
    actor: GaussianActor
    slow_actor: GaussianActor
    critics: CriticEnsemble
    target_critics: CriticEnsemble
    value_bounds: Float[Array, "2"]  # smallest and largest target; infinite when targets are not clipped
    step: Int[Array, ""]
    values: Float[Array, " rows"] | None = None  # in the actor's loss: those that the actor climbs, at its own actions
    counted: Float[Array, " rows"] | None = None  # there too: 1.0 where the logged action is to be followed; None: all


class Term(abc.ABC):
    """An addition to the actor's loss, the critics' loss or the target, or to several: a frozen dataclass.

    A term owns its hyper-parameters, its metrics, and a state of its own: the model that `pretrain` fitted, which stays
    frozen, or what it remembers from update to update, or both. Its weight is applied inside. A term of weight 0 is
    left out of training altogether, so it costs nothing and changes nothing. Settings that are floating-point numbers
    are traced, as `odaf.algorithms.base.Algorithm` says.
    """

    name: ClassVar[str]
    acts_on_actor: ClassVar[bool] = False
    acts_on_critics: ClassVar[bool] = False
    acts_on_target: ClassVar[bool] = False
    needs_next_state: ClassVar[bool] = False  # reads s' as the state after one step, so targets must span one step
    weight: float

    @property
    def can_be_padded(self) -> bool:
        """Whether it computes with columns of zeros what it computes without them; see `odaf.data.padding`."""
        return False

    def citations(self) -> tuple[Citation, ...]:
        """The papers to name beside results of these settings."""
        return ()

    def extras(self) -> tuple[Extra, ...]:
        """Further columns of a row that the term reads, as `odaf.data.view.View` names them."""
        return ()

    def untrained(self, key: PRNGKeyArray, spec: Spec) -> PyTree:
        """The term's model before pre-training; () when it has none."""
        del key, spec
        return ()

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[PyTree, dict[str, Any]]:
        """Train the model; the report's entry "warnings" lists sentences for the user."""
        del dataset, normaliser, key, progress
        return (), {"warnings": []}

    def pretraining(self) -> Hashable:
        """The settings that decide what `pretrain` gives, as `odaf.algorithms.base.Algorithm.pretraining` has it."""
        return () if type(self).pretrain is Term.pretrain else self

    def init(self, model: PyTree) -> PyTree:
        """The term's state before the first update, around its trained model; by default the model itself."""
        return model

    def next_state(self, state: PyTree, step: Int[Array, ""], metrics: Metrics) -> PyTree:
        """The term's state after an update.

        Args:
            state: the state that the update saw.
            step: updates made, this one included.
            metrics: the term's own metrics of this update, among others.
        """
        del step, metrics
        return state

    def actor_loss(self, context: Context, state: PyTree, key: PRNGKeyArray) -> tuple[Float[Array, ""], Metrics]:
        """Weighted addition to the actor's loss. Gradients must reach `context.actor` only."""
        del context, state, key
        return jnp.zeros(()), {}

    def critic_loss(self, context: Context, state: PyTree, key: PRNGKeyArray) -> tuple[Float[Array, ""], Metrics]:
        """Weighted addition to the critics' loss. Gradients must reach `context.critics` only."""
        del context, state, key
        return jnp.zeros(()), {}

    def target_penalty(
        self,
        context: Context,
        state: PyTree,
        next_actions: Float[Array, "rows act_dim"],
        log_density: Float[Array, " rows"],
        key: PRNGKeyArray,
    ) -> Float[Array, " rows"]:
        """Weighted deduction from the value of each next state in the critics' target; it receives no gradient.

        Args:
            context: of the update, before any of its steps.
            state: the term's.
            next_actions: a' ~ pi(s'), the actions whose values the target takes.
            log_density: log pi(a'|s').
            key: random key of the term.
        """
        del context, state, log_density, key
        return jnp.zeros(next_actions.shape[0])
