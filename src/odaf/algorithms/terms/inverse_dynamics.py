"""What OSR's two terms share: states beside the log's, and a model of inverse dynamics that knows the way back."""

import dataclasses
from collections.abc import Hashable
from typing import Any, ClassVar

import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.algorithms.base import PretrainProgress
from odaf.algorithms.terms.base import Term
from odaf.components.inverse_dynamics import InverseDynamics, InverseDynamicsConfig, fit_inverse, untrained_inverse
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class InverseDynamicsTerm(Term):
    """A term with a model of inverse dynamics; s' must be the next state, so `return_steps` has to be 1."""

    needs_next_state: ClassVar[bool] = True

    weight: float
    """Weight in the loss; 0 leaves the term out."""
    state_noise: float = 1e-3
    """beta, standard deviation of the normal noise on the states, in standard deviations of the log."""
    model: InverseDynamicsConfig = dataclasses.field(default_factory=InverseDynamicsConfig)
    """The model of inverse dynamics."""

    def __post_init__(self) -> None:
        for field in ("weight", "state_noise"):
            if getattr(self, field) < 0:
                raise ConfigError(f"{self.name}.{field}={getattr(self, field)} must not be negative")

    def untrained(self, key: PRNGKeyArray, spec: Spec) -> InverseDynamics:
        """The model before training."""
        return untrained_inverse(self.model, key, spec.obs_dim, spec.act_dim)

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[InverseDynamics, dict[str, Any]]:
        """Fit the model on the log."""
        return fit_inverse(
            self.model,
            dataset,
            normaliser,
            key,
            lambda done, steps: progress("inverse-dynamics model", done, steps),
            self.name,
        )

    def pretraining(self) -> Hashable:
        """The model's settings."""
        return self.model

    def states_beside(self, batch: Transitions, key: PRNGKeyArray) -> Float[Array, "rows obs_dim"]:
        """s^ = s + beta * noise."""
        return batch.observations + self.state_noise * jr.normal(key, batch.observations.shape)


def mean_where_followed(values: Float[Array, " rows"], batch: Transitions) -> Float[Array, ""]:
    """Mean over rows whose next state was recorded; 0 if there are none.

    Left out are true ends that repeat their own state as a placeholder.
    """
    repeats = jnp.all(batch.observations == batch.next_observations, axis=1)
    keep = 1.0 - batch.terminated * repeats.astype(batch.terminated.dtype)
    return jnp.sum(values * keep) / jnp.maximum(jnp.sum(keep), 1.0)
