"""Behaviour cloning: the policy that does what the log did, on average.

    deterministic:  L = mean_{B, dims} ( mu(s) - a )^2,                 mu = tanh(MLP)
    Gaussian:       L = - mean_B log N( a; mu(s), std^2 ),              one std a dimension for all states

It ignores rewards, so it is the floor that an offline learner has to beat. Both act by mu; the Gaussian's likelihood
weighs each dimension by how well it can be cloned, and it has a density for what asks for one. With rows of the best
episodes alone (`sampling="best"`) it is "10 % BC".
"""

import dataclasses
from typing import ClassVar, Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Algorithm, LearnerState, Metrics
from odaf.algorithms.ranges import require_counts, require_not_negative
from odaf.components.distributions import gaussian_log_density
from odaf.components.policies import Actor, DeterministicActor, UnsquashedGaussianActor, init_deterministic_actor
from odaf.components.trained import Trained
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import View


class CloningState(LearnerState):
    """State of behaviour cloning."""

    step: Int[Array, ""]
    actor: Trained[Actor]  # no slow copy


def cloning_loss(actor: Actor, batch: Transitions) -> Float[Array, ""]:
    """Mean over rows and action dimensions of (mu(s) - a)^2; of a Gaussian, mean over rows of -log pi(a|s) in nats."""
    if isinstance(actor, DeterministicActor):
        return batch.mean_over_actions(jnp.square(actor.mode(batch.observations) - batch.actions))
    assert isinstance(actor, UnsquashedGaussianActor)
    return -jnp.mean(gaussian_log_density(*actor.parameters(batch.observations), batch.actions, batch.own_actions))


@dataclasses.dataclass(frozen=True)
class BehaviourCloning(Algorithm[CloningState]):
    """Regression of logged actions on states."""

    kind: ClassVar[str] = "behaviour-cloning"
    structural: ClassVar[frozenset[str]] = frozenset({"normaliser_epsilon"})

    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths of the actor's hidden layers."""
    actor_kind: Literal["deterministic", "gaussian"] = "deterministic"
    """What is cloned: a single action a state by squared error, or by likelihood a Gaussian that is not squashed."""
    learning_rate: float = 3e-4
    """Step size of Adam."""
    batch_size: int = 256
    """Transitions a gradient step."""
    normaliser_epsilon: float = 0.0
    """Added to the standard deviations that observations are divided by, in their own units (papers 1e-3); 0 makes
    units of no account."""

    def __post_init__(self) -> None:
        require_counts(self, ["batch_size"])
        require_not_negative(self, ["normaliser_epsilon"])

    def view(self) -> View:
        """Single rows; rewards do not matter."""
        return View(normaliser_epsilon=self.normaliser_epsilon)

    def can_be_padded(self) -> bool:
        """Yes: what it averages and draws is of own dimensions."""
        return type(self) is BehaviourCloning

    def citations(self) -> tuple[citations.Citation, ...]:
        """Cloning of logged actions by a network."""
        return (citations.CLONING,)

    def init(self, key: PRNGKeyArray, spec: Spec, models: PyTree) -> CloningState:
        """Random actor, of a Gaussian with standard deviations of 1; fresh optimiser."""
        del models
        actor = init_deterministic_actor(key, spec.obs_dim, spec.act_dim, self.hidden_sizes)
        if self.actor_kind == "gaussian":
            actor = UnsquashedGaussianActor(actor.network, jnp.zeros(spec.act_dim))
        return CloningState(jnp.asarray(0), Trained.begin(actor, slow=False))

    def update(self, state: CloningState, batch: Transitions, key: PRNGKeyArray) -> tuple[CloningState, Metrics]:
        """One Adam step on the cloning loss."""
        del key
        loss, gradient = jax.value_and_grad(cloning_loss)(state.actor.now, batch)
        return CloningState(state.step + 1, state.actor.stepped(gradient, self.learning_rate)), {"actor/loss": loss}

    def actor(self, state: CloningState) -> Actor:
        """mu, or the Gaussian around it."""
        return state.actor.now
