"""SDC's term on the actor: from beside the log's states, act so that what follows looks like what followed in the log.

    L_sdc  = weight alpha mean_B ( MMD( x, y ) - threshold ),             alpha climbs along mean_B MMD - threshold
    x_i    = M( s^, a_i ),    a_i ~ pi(s^),    s^ = s + beta * noise      n draws, differentiable in the actor
    y_j    ~ U( s )                                                       n draws, constants

M is a model of the dynamics and U, a conditional auto-encoder, one of what follows a state in the log whatever the
action; both are fitted beforehand and frozen (Zhang et al. 2022). States are in standard deviations of the log, and so
are the kernel's distances. The page docs/reference/algorithms/sdc.md tells what differs from the paper.
"""

import dataclasses
from collections.abc import Hashable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Int, PRNGKeyArray

from odaf.algorithms import citations
from odaf.algorithms.base import Metrics, PretrainProgress
from odaf.algorithms.terms.base import Context, Term
from odaf.components.discrepancy import discrepancy
from odaf.components.duals import Dual, ascended
from odaf.components.dynamics import DynamicsConfig, DynamicsModel, fit_dynamics
from odaf.components.dynamics import untrained as untrained_dynamics
from odaf.components.policies import draw_actions
from odaf.components.targets import frozen
from odaf.components.trained import Trained
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.errors import ConfigError

Models = tuple[DynamicsModel, DynamicsModel]  # M and U
DYNAMICS = DynamicsConfig(
    kind="ensemble", hidden_sizes=(200, 200, 200, 200), steps=100_000, schedule="constant", patience=5
)
TRANSITIONS = DynamicsConfig(kind="cvae", encoder="transition", steps=100_000, schedule="constant")


class DeviationState(eqx.Module):
    """The frozen models and the multiplier."""

    dynamics: DynamicsModel  # M
    transitions: DynamicsModel  # U, whose actions have no dimensions
    log_multiplier: Dual  # log alpha


@dataclasses.dataclass(frozen=True)
class StateDeviation(Term):
    """Keep what follows the policy's actions near logged states like what followed in the log (SDC)."""

    name: ClassVar[str] = "state_deviation"
    acts_on_actor: ClassVar[bool] = True

    weight: float = 1.0
    """Factor beside the multiplier; 0 leaves the term out."""
    state_noise: float = 1e-3
    """beta, standard deviation of the normal noise on the states, in standard deviations of the log."""
    threshold: float = 0.05
    """Discrepancy that is allowed: the multiplier falls below it and climbs above it."""
    num_draws: int = 4
    """n, next states a state, of the policy and of the log."""
    kernel_width: float | None = None
    """Width of the Gaussian kernel, in squared standard deviations of the log; None takes the number of dimensions."""
    multiplier_learning_rate: float = 1e-3
    """Step size of Adam for log alpha; 0 keeps alpha at its initial value."""
    initial_multiplier: float = 1.0
    """alpha at step 0."""
    dynamics: DynamicsConfig = DYNAMICS
    """M, the model of the next state."""
    transitions: DynamicsConfig = TRANSITIONS
    """U, the model of what follows a state in the log, with the same settings; a cvae whose encoder sees s'."""

    def __post_init__(self) -> None:
        for field in ("weight", "state_noise", "threshold", "multiplier_learning_rate"):
            if getattr(self, field) < 0:
                raise ConfigError(f"state_deviation.{field}={getattr(self, field)} must not be negative")
        if self.num_draws < 1:
            raise ConfigError(f"state_deviation.num_draws={self.num_draws} must be at least 1")
        for field in ("kernel_width", "initial_multiplier"):
            value = getattr(self, field)
            if value is not None and not value > 0.0:
                raise ConfigError(f"state_deviation.{field}={value} must be positive")

    def citations(self) -> tuple[citations.Citation, ...]:
        """SDC."""
        return (citations.SDC,)

    # ---- models -------------------------------------------------------------------------------------------------

    def untrained(self, key: PRNGKeyArray, spec: Spec) -> Models:
        """Both models before training."""
        key_dynamics, key_transitions = jr.split(key)
        return (
            untrained_dynamics(self.dynamics, key_dynamics, spec.obs_dim, spec.act_dim),
            untrained_dynamics(self.transitions, key_transitions, spec.obs_dim, 0),
        )

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[Models, dict[str, Any]]:
        """Fit both models on the log; the report has an entry for each."""
        keys = dict(zip(("dynamics", "transitions"), jr.split(key), strict=True))
        models: list[DynamicsModel] = []
        report: dict[str, Any] = {"warnings": []}
        for field, own in keys.items():
            model, report[field] = fit_dynamics(
                getattr(self, field),
                dataset,
                normaliser,
                own,
                lambda done, steps, field=field: progress(f"{field} model", done, steps),
                use="the actor is held to states the system would not reach",
                remedy=f"leave out the term ({self.name}.weight=0)",
                field=f"{self.name}.{field}",
                sees_actions=field == "dynamics",
            )
            models.append(model)
            report["warnings"] += report[field].pop("warnings")
        return (models[0], models[1]), report

    def pretraining(self) -> Hashable:
        """Both models' settings."""
        return self.dynamics, self.transitions

    def init(self, model: Models) -> DeviationState:
        """The models, and log alpha with its optimiser."""
        log_multiplier = jnp.log(jnp.asarray(self.initial_multiplier, jnp.float32))
        return DeviationState(*model, Trained.begin(log_multiplier, slow=False))

    # ---- loss ---------------------------------------------------------------------------------------------------

    def actor_loss(
        self, context: Context, state: DeviationState, key: PRNGKeyArray
    ) -> tuple[Float[Array, ""], Metrics]:
        """weight * alpha * (mean MMD - threshold); its gradient reaches the actor only."""
        found = jnp.mean(self.discrepancies(context, state, key))
        multiplier = jax.lax.stop_gradient(jnp.exp(state.log_multiplier.now))
        metrics = {"state_deviation/discrepancy": found, "state_deviation/multiplier": multiplier}
        return self.weight * multiplier * (found - self.threshold), metrics

    def discrepancies(self, context: Context, state: DeviationState, key: PRNGKeyArray) -> Float[Array, " rows"]:
        """MMD between x and y of every row."""
        key_state, key_action, key_outcome, key_logged = jr.split(key, 4)
        states = context.batch.observations
        rows, obs_dim = states.shape
        shape = (self.num_draws, rows, obs_dim)
        beside = states + self.state_noise * jr.normal(key_state, states.shape)
        noise = jr.normal(key_action, (self.num_draws, *context.batch.actions.shape))
        actions, _ = draw_actions(context.actor, beside, noise)
        outcomes = frozen(state.dynamics).predict_draws(jnp.broadcast_to(beside[None], shape), actions, key_outcome)
        none = jnp.zeros((*shape[:2], 0), states.dtype)
        logged = state.transitions.predict_draws(jnp.broadcast_to(states[None], shape), none, key_logged)
        width = float(obs_dim) if self.kernel_width is None else self.kernel_width
        return discrepancy(outcomes, jax.lax.stop_gradient(logged), "gaussian", width)

    def next_state(self, state: DeviationState, step: Int[Array, ""], metrics: Metrics) -> DeviationState:
        """alpha climbs where the discrepancy is above the threshold, and falls where it is below."""
        del step
        violation = metrics["state_deviation/discrepancy"] - self.threshold
        log_multiplier = ascended(state.log_multiplier, violation, self.multiplier_learning_rate)
        return dataclasses.replace(state, log_multiplier=log_multiplier)
