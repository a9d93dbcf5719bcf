"""What MOPO and COMBO share: soft actor-critic on the log and on rollouts of a model of transitions fitted to it.

    y    = r + discount (1 - d) ( min_k Q'_k(s', a') [- alpha log pi(a'|s')] ),       a' ~ pi(s')
    L_pi = mean_B ( alpha log pi(a~|s) - min_k Q_k(s, a~) ),                           a~ ~ pi(s)

Before the first update and then every `refresh_every` updates, `rollout_rows` states of the log are played on from for
`horizon` steps of the model by the current actor, with draws; their rows go into a ring that has room for `retained`
such refreshes. A batch is `real_fraction` rows of the log (rounded down, but one at least unless it is 0), then rows of
the ring.
"""

import abc
import dataclasses
from collections.abc import Hashable
from typing import Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Int, PRNGKeyArray

from odaf.algorithms.base import Algorithm, LearnerState, Metrics, PretrainProgress
from odaf.algorithms.ranges import (
    require_counts,
    require_not_negative,
    require_positive,
    require_temporal_difference,
)
from odaf.components.adam import falling_rate
from odaf.components.critics import CriticEnsemble, init_critics
from odaf.components.dynamics import EnsembleConfig, TransitionEnsemble, fit_transitions
from odaf.components.dynamics.rollouts import Ring, Rolled, rollout
from odaf.components.dynamics.terminations import Termination, termination
from odaf.components.dynamics.transition_ensemble import Uncertainty
from odaf.components.losses import soft_actor_loss, temperature_loss
from odaf.components.networks import MLP, init_mlp
from odaf.components.policies import GaussianActor
from odaf.components.targets import bellman_target
from odaf.components.trained import Trained
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser, scale_actions
from odaf.data.sampling import Columns, sample
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import View
from odaf.errors import ConfigError

TOLERATED = 0.01  # share of logged ends, and of other rows, on which a termination may be wrong without a warning


class ModelBasedState(LearnerState):
    """State of a learner of this family."""

    step: Int[Array, ""]
    actor: Trained[GaussianActor]  # no slow copy
    critics: Trained[MLP]
    log_temperature: Trained[Float[Array, ""]]  # log alpha; no slow copy
    dynamics: TransitionEnsemble  # frozen
    ring: Ring  # of rollouts


@dataclasses.dataclass(frozen=True)
class ModelBased(Algorithm[ModelBasedState]):
    """Soft actor-critic on a mixture of the log and of rollouts of a model fitted to it."""

    structural: ClassVar[frozenset[str]] = frozenset({"normaliser_epsilon", "real_fraction"})

    dynamics: EnsembleConfig = dataclasses.field(default_factory=EnsembleConfig)
    """The model of transitions, and how it is fitted before the first update."""
    termination: str = "never"
    """When a rollout ends: never, halfcheetah, hopper, walker2d, or the name of a function of your own."""
    horizon: int = 1
    """h, steps of a rollout at most."""
    rollout_rows: int = 50_000
    """Rollouts at each refresh, from so many states of the log."""
    retained: int = 5
    """Refreshes whose rows the ring has room for."""
    refresh_every: int = 1_000
    """Updates between two refreshes."""
    real_fraction: float = 0.5
    """Share of a batch that comes from the log, the rest is of rollouts."""
    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers of actor and critics."""
    discount: float = 0.99
    """gamma, in [0, 1)."""
    target_rate: float = 5e-3
    """Share of the critics that enters their slow copies at each update."""
    actor_learning_rate: float = 1e-4
    """Step size of Adam for the actor at the start."""
    actor_decay_updates: int = 1_000_000
    """Updates within which the actor's step size falls to 0 along half a cosine; 0 keeps it as it is."""
    critic_learning_rate: float = 3e-4
    """Step size of Adam for the critics."""
    temperature_learning_rate: float = 1e-4
    """Step size of Adam for log alpha; 0 keeps alpha at its initial value."""
    initial_temperature: float = 1.0
    """alpha at step 0."""
    temperature_max: float | None = None
    """Largest alpha that counts; None sets no bound."""
    target_entropy: float | None = None
    """Entropy in nats that alpha steers to; None gives minus the number of action dimensions."""
    batch_size: int = 256
    """Transitions a gradient step, those of the log and of rollouts together."""
    normaliser_epsilon: float = 1e-3
    """Added to the standard deviations that observations are divided by, in their own units."""

    def __post_init__(self) -> None:
        termination(self.termination)
        require_temporal_difference(self)
        if not 0.0 <= self.real_fraction < 1.0:
            raise ConfigError(
                f"real_fraction={self.real_fraction} must lie in [0, 1): with 1 no rollout is learnt from; take a "
                "learner that needs no model then, such as td3-bc"
            )
        require_positive(self, ["initial_temperature"])
        if self.temperature_max is not None:
            require_positive(self, ["temperature_max"])  # below it, entropy would be pressed down
        require_counts(self, ("horizon", "rollout_rows", "retained", "refresh_every", "batch_size"))
        require_not_negative(self, ("actor_decay_updates", "normaliser_epsilon"))
        if self.real_rows == self.batch_size:
            raise ConfigError(f"batch_size={self.batch_size} leaves no row for rollouts; raise it")

    @property
    def real_rows(self) -> int:
        """Rows of a batch that come from the log: its first ones."""
        return max(int(self.batch_size * self.real_fraction), 1 if self.real_fraction > 0.0 else 0)

    def view(self) -> View:
        """Single rows with the reward as logged."""
        return View(discount=self.discount, normaliser_epsilon=self.normaliser_epsilon)

    # ---- before training ----------------------------------------------------------------------------------------

    def untrained(self, key: PRNGKeyArray, spec: Spec) -> TransitionEnsemble:
        """The model as drawn."""
        return self.dynamics.untrained(key, spec.obs_dim, spec.act_dim)

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[TransitionEnsemble, dict[str, Any]]:
        """The model fitted to the log; the report says what it is worth, and whether `termination` fits the log.

        Raises:
            ConfigError: `termination` does not give one truth value a row.
        """
        ends = termination_errors(termination(self.termination), dataset)  # first: it takes no time, the fit does
        model, findings = fit_transitions(
            self.dynamics,
            dataset,
            normaliser,
            key,
            lambda done, steps: progress("dynamics model", done, steps),
        )
        warnings = findings.pop("warnings")
        for name, what in (("missed", "true ends"), ("invented", "rows that went on")):
            if ends[name] > TOLERATED:
                warnings.append(
                    f"termination={self.termination!r} is wrong about {100 * ends[name]:.0f} % of the log's {what}, so "
                    "rollouts run on where the task has ended, or end where it goes on; choose the function of this "
                    "task, or register one of your own"
                )
        return model, {"dynamics": findings, "termination": ends, "warnings": warnings}

    def pretraining(self) -> Hashable:
        """The model's settings, and the function that the report judges."""
        return self.dynamics, self.termination

    def init(self, key: PRNGKeyArray, spec: Spec, models: TransitionEnsemble) -> ModelBasedState:
        """Random networks, slow critics equal to the critics, an empty ring, fresh optimisers."""
        key_actor, key_critics = jr.split(key)
        sizes = (spec.obs_dim, *self.hidden_sizes, 2 * spec.act_dim)
        critics = init_critics(
            key_critics, spec.obs_dim, spec.act_dim, self.hidden_sizes, 2, "none", None, hidden_bias=0.0
        )
        log_temperature = jnp.log(jnp.asarray(self.initial_temperature, jnp.float32))
        return ModelBasedState(
            step=jnp.asarray(0),
            actor=Trained.begin(GaussianActor(init_mlp(key_actor, sizes, hidden_bias=0.0)), slow=False),
            critics=Trained.begin(critics),
            log_temperature=Trained.begin(log_temperature, slow=False),
            dynamics=models,
            ring=Ring.empty(self.rollout_rows * self.horizon * self.retained, spec.obs_dim, spec.act_dim),
        )

    # ---- batches ------------------------------------------------------------------------------------------------

    @abc.abstractmethod
    def rolled(self, state: ModelBasedState, starts: Float[Array, "starts obs_dim"], key: PRNGKeyArray) -> Rolled:
        """Rollouts of the current actor, their rewards as they are learnt from."""

    def play(
        self,
        state: ModelBasedState,
        starts: Float[Array, "starts obs_dim"],
        key: PRNGKeyArray,
        doubts: Uncertainty | None = None,
        actions: Literal["policy", "uniform"] = "policy",
    ) -> Rolled:
        """Rollouts of `horizon` steps with draws of the current actor, or with actions drawn uniformly."""
        actor, width = state.actor.now, state.ring.rows.actions.shape[1]

        def behave(states: Array, key: PRNGKeyArray) -> Array:
            if actions == "uniform":
                return jr.uniform(key, (states.shape[0], width), minval=-1.0, maxval=1.0)
            return actor.act((), states, key)[0]

        return rollout(state.dynamics, behave, starts, self.horizon, termination(self.termination), key, doubts)

    def refresh(self, state: ModelBasedState, columns: Columns, key: PRNGKeyArray) -> ModelBasedState:
        """New rollouts in the ring, from states of the log."""
        key_start, key_roll = jr.split(key)
        starts = sample(columns, key_start, self.rollout_rows).observations
        found = self.rolled(state, starts, key_roll)
        return dataclasses.replace(state, ring=state.ring.pushed(found.rows, found.kept))

    def batch(self, state: ModelBasedState, columns: Columns, key: PRNGKeyArray) -> Transitions:
        """Rows of the log, then rows of the ring."""
        key_real, key_rolled = jr.split(key)
        real = sample(columns, key_real, self.real_rows)
        rolled = state.ring.sample(key_rolled, self.batch_size - self.real_rows)
        return jax.tree.map(lambda *parts: jnp.concatenate(parts), real, rolled)

    # ---- losses -------------------------------------------------------------------------------------------------

    def temperature(self, state: ModelBasedState) -> Float[Array, ""]:
        """alpha, a constant in the losses of others; its logarithm goes on where it is bounded."""
        value = jax.lax.stop_gradient(jnp.exp(state.log_temperature.now))
        return value if self.temperature_max is None else jnp.minimum(value, self.temperature_max)

    def target(
        self, actor: GaussianActor, state: ModelBasedState, batch: Transitions, key: PRNGKeyArray, entropy: bool
    ) -> Float[Array, " rows"]:
        """y, the same for both critics; with the entropy of a' if asked for."""
        assert state.critics.slow is not None
        actions, log_density = actor.sample(batch.next_observations, jr.normal(key, batch.actions.shape))
        values = jnp.min(CriticEnsemble(state.critics.slow)(batch.next_observations, actions), axis=0)
        if entropy:
            values = values - self.temperature(state) * log_density
        return bellman_target(batch.rewards, batch.terminated, values, self.discount)

    def actor_loss(
        self,
        actor: GaussianActor,
        state: ModelBasedState,
        critics: CriticEnsemble,
        batch: Transitions,
        key: PRNGKeyArray,
    ) -> tuple[Float[Array, ""], tuple[Float[Array, " rows"], Metrics]]:
        """L_pi as a function of the actor; also log pi(a~|s) for the temperature."""
        actions, log_density = actor.sample(batch.observations, jr.normal(key, batch.actions.shape))
        values = jnp.min(critics.as_constants(batch.observations, actions), axis=0)
        loss = soft_actor_loss(log_density, values, self.temperature(state))
        metrics = {"actor/loss": loss, "actor/value": jnp.mean(values), "actor/entropy": -jnp.mean(log_density)}
        return loss, (log_density, metrics)

    def actor_stepped(
        self, state: ModelBasedState, critics: MLP, batch: Transitions, key: PRNGKeyArray
    ) -> tuple[ModelBasedState, Metrics]:
        """After a step of the actor against these critics, and of log alpha by the entropy that its loss saw."""
        slope, (log_density, metrics) = jax.grad(self.actor_loss, has_aux=True)(
            state.actor.now, state, CriticEnsemble(critics), batch, key
        )
        rate = falling_rate(self.actor_learning_rate, state.step, self.actor_decay_updates)
        target_entropy = float(-batch.actions.shape[1]) if self.target_entropy is None else self.target_entropy
        climb = jax.grad(temperature_loss)(state.log_temperature.now, log_density, target_entropy)
        stepped = dataclasses.replace(
            state,
            actor=state.actor.stepped(slope, rate),
            log_temperature=state.log_temperature.stepped(climb, self.temperature_learning_rate),
        )
        return stepped, metrics | {"temperature/value": self.temperature(stepped)}

    def actor(self, state: ModelBasedState) -> GaussianActor:
        """pi."""
        return state.actor.now

    def values(self, state: ModelBasedState) -> CriticEnsemble:
        """Both critics."""
        return CriticEnsemble(state.critics.now)


def termination_errors(ends: Termination, dataset: Dataset) -> dict[str, Any]:
    """Shares of a log on which a termination is wrong, among rows whose successor was recorded.

    Returns:
        "missed" of the true ends ("ends" is how many there are), and "invented" of the other rows; 0 of none.

    Raises:
        ConfigError: it does not give one truth value a row.
    """
    recorded = ~(dataset.terminated & np.all(dataset.observations == dataset.next_observations, axis=1))
    columns = dataset.observations, scale_actions(dataset.actions, dataset.action_low, dataset.action_high)
    found = np.asarray(ends(*(jnp.asarray(c, jnp.float32) for c in (*columns, dataset.next_observations))))
    if found.shape != (len(dataset),) or found.dtype != bool:
        raise ConfigError(
            f"termination={getattr(ends, '__name__', ends)!r} gives {found.dtype} of shape {found.shape} for "
            f"{len(dataset):,} rows; it must give one truth value a row, such as next_observations[:, 0] > 2.5"
        )
    true, others = recorded & dataset.terminated, ~dataset.terminated
    return {
        "ends": int(true.sum()),
        "missed": float((~found)[true].mean()) if true.any() else 0.0,
        "invented": float(found[others].mean()) if others.any() else 0.0,
    }
