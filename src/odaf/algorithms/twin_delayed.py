"""The core of TD3 (Fujimoto et al. 2018) that its offline relatives share: settings, state, and the order of a step.

    a' = clip( mu'(s') + clip(noise, -c, c), -1, 1 ),                noise ~ N(0, target_noise^2)

The critics step first. Every `actor_delay`-th update the actor steps against the new critics, and all slow copies move
then and only then.
"""

import dataclasses
from collections.abc import Callable
from typing import ClassVar

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms.base import Algorithm, LearnerState, Metrics
from odaf.algorithms.numbers import is_off
from odaf.algorithms.ranges import require_counts, require_not_negative, require_temporal_difference
from odaf.components.adam import falling_rate
from odaf.components.critics import CriticEnsemble, init_critics
from odaf.components.losses import ensemble_td_gradient
from odaf.components.networks import MLP
from odaf.components.numbers import Number
from odaf.components.policies import DeterministicActor, init_deterministic_actor
from odaf.components.targets import bellman_target, polyak
from odaf.components.trained import Trained
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import View

Act = Callable[[DeterministicActor, Float[Array, "rows obs_dim"]], Float[Array, "rows act_dim"]]
ActorLoss = Callable[[DeterministicActor, CriticEnsemble], tuple[Float[Array, ""], Metrics]]
CriticGradient = Callable[
    [CriticEnsemble, Transitions, Float[Array, " rows"]], tuple[CriticEnsemble, Float[Array, "critics rows"], Metrics]
]


class TwinDelayedState(LearnerState):
    """State of TD3 and its relatives."""

    step: Int[Array, ""]
    actor: Trained[DeterministicActor]
    critics: Trained[MLP]
    actor_metrics: dict[str, Float[Array, ""]]  # of the last actor step, so that means do not count the steps without
    models: PyTree = ()  # what was fitted to the log beforehand, and constants of the log; they stay as they are

    @classmethod
    def begin(
        cls, actor: DeterministicActor, critics: MLP, metrics: tuple[str, ...], models: PyTree = ()
    ) -> "TwinDelayedState":
        """Slow copies equal to the networks, fresh optimisers, the actor's metrics 0 until its first step."""
        none_yet = {name: jnp.zeros(()) for name in metrics}
        return cls(jnp.asarray(0), Trained.begin(actor), Trained.begin(critics), none_yet, models)


def td_gradient(
    critics: CriticEnsemble, batch: Transitions, target: Float[Array, " rows"]
) -> tuple[CriticEnsemble, Float[Array, "critics rows"], Metrics]:
    """Gradient of L_Q = sum_k mean_B ( Q_k(s, a) - y )^2, the values of the logged actions, and the loss."""
    gradient, loss, values = ensemble_td_gradient(critics, batch.observations, batch.actions, target)
    return gradient, values, {"critic/loss": loss}


@dataclasses.dataclass(frozen=True)
class TwinDelayed(Algorithm[TwinDelayedState]):
    """TD3's settings and what they decide; a relative adds its own, its target and its actor's loss."""

    structural: ClassVar[frozenset[str]] = frozenset({"normaliser_epsilon"})
    not_negative: ClassVar[tuple[str, ...]] = ()  # settings of a relative's own that must not be

    hidden_sizes: tuple[int, ...] = (256, 256)
    """Widths of the hidden layers of actor and critics."""
    discount: float = 0.99
    """gamma, in [0, 1)."""
    target_noise: float = 0.2
    """Standard deviation of the noise on the target's action."""
    noise_clip: float = 0.5
    """c, the largest size of that noise."""
    actor_delay: int = 2
    """Updates of the critics for each of the actor and of the slow copies."""
    target_rate: float = 5e-3
    """Share of the networks that enters their slow copies at each actor step."""
    batch_size: int = 256
    """Transitions a gradient step."""
    normaliser_epsilon: float = 1e-3
    """Added to the standard deviations that observations are divided by, in their own units."""

    def __post_init__(self) -> None:
        require_temporal_difference(self)
        require_counts(self, ("actor_delay", "batch_size"))
        require_not_negative(self, (*self.not_negative, "target_noise", "noise_clip", "normaliser_epsilon"))

    def view(self) -> View:
        """Single rows; papers add 1e-3 to the spreads."""
        return View(discount=self.discount, normaliser_epsilon=self.normaliser_epsilon)

    def next_step(
        self, state: TwinDelayedState, batch: Transitions, key: PRNGKeyArray, act: Act = DeterministicActor.mode
    ) -> tuple[Float[Array, "rows act_dim"], Float[Array, "critics rows"]]:
        """a' and Q'_k(s', a').

        Args:
            state: whose slow copies are asked.
            batch: rows of the log.
            key: of the noise; without noise nothing is drawn.
            act: what the slow actor does at s'.
        """
        assert state.actor.slow is not None and state.critics.slow is not None
        actions = act(state.actor.slow, batch.next_observations)
        if not is_off(self.target_noise):
            noise = self.target_noise * batch.action_noise(key)
            actions = jnp.clip(actions + jnp.clip(noise, -self.noise_clip, self.noise_clip), -1.0, 1.0)
        return actions, CriticEnsemble(state.critics.slow)(batch.next_observations, actions)

    def updated(
        self,
        state: TwinDelayedState,
        batch: Transitions,
        target: Float[Array, " rows"],
        actor_loss: ActorLoss,
        *,
        actor_rate: Number,
        critic_rate: Number,
        critic_gradient: CriticGradient = td_gradient,
    ) -> tuple[TwinDelayedState, Metrics]:
        """A step of the critics towards the target; at every `actor_delay`-th one of the actor and the slow copies.

        Args:
            state: before the step.
            batch: rows of the log.
            target: y, the same for all critics.
            actor_loss: of an actor against critics, whose gradient reaches the actor only, with its metrics.
            actor_rate: the actor's step size.
            critic_rate: the critics' step size.
            critic_gradient: of the critics' loss, with the values of the logged actions and further metrics.
        """
        gradient, values, losses = critic_gradient(CriticEnsemble(state.critics.now), batch, target)
        state = dataclasses.replace(state, critics=state.critics.stepped(gradient.networks, critic_rate))

        def actor_step(state: TwinDelayedState) -> TwinDelayedState:
            critics = CriticEnsemble(state.critics.now)
            gradient, metrics = jax.grad(actor_loss, has_aux=True)(state.actor.now, critics)
            slow = polyak(state.critics.slow, state.critics.now, self.target_rate)
            return dataclasses.replace(
                state,
                actor=state.actor.stepped(gradient, actor_rate, self.target_rate),
                critics=dataclasses.replace(state.critics, slow=slow),
                actor_metrics=metrics,
            )

        is_due = (state.step + 1) % self.actor_delay == 0
        state = jax.lax.cond(is_due, actor_step, lambda state: state, state)
        metrics = losses | {
            "critic/mean": jnp.mean(values),
            "critic/min": jnp.min(values),
            "critic/max": jnp.max(values),
            "target/mean": jnp.mean(target),
        }
        return dataclasses.replace(state, step=state.step + 1), metrics | state.actor_metrics

    def actor(self, state: TwinDelayedState) -> DeterministicActor:
        """mu."""
        return state.actor.now

    def values(self, state: TwinDelayedState) -> CriticEnsemble:
        """All critics."""
        return CriticEnsemble(state.critics.now)


@dataclasses.dataclass(frozen=True)
class TwinDelayedWithModel(TwinDelayed):
    """A relative that fits a model to the log beforehand: any number of critics, and rates for each side."""

    num_critics: int = 2
    """K, the number of Q-functions."""
    reward_shift: float = 0.0
    """Added to every reward, such as -1 in mazes whose reward is 1 at the goal."""
    actor_learning_rate: float = 3e-4
    """Step size of Adam for the actor."""
    actor_decay_updates: int = 0
    """Updates in which the actor's step size falls to 0 along half a cosine; 0 keeps it."""
    critic_learning_rate: float = 3e-4
    """Step size of Adam for the critics."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_counts(self, ["num_critics"])
        require_not_negative(self, ["actor_decay_updates"])

    def begin(
        self,
        key: PRNGKeyArray,
        spec: Spec,
        metrics: tuple[str, ...],
        models: PyTree,
        output_bounds: tuple[float | None, float | None] = (None, None),
    ) -> TwinDelayedState:
        """Random networks without layer normalisation, slow copies equal to them, fresh optimisers.

        Args:
            key: random key.
            spec: sizes.
            metrics: names of those of the actor's loss.
            models: what stays as it is.
            output_bounds: the last layers of actor and critics are uniform in plus or minus this; None draws them like
                hidden ones.
        """
        key_actor, key_critics = jr.split(key)
        sizes, (actor_bound, critic_bound) = self.hidden_sizes, output_bounds
        actor = init_deterministic_actor(key_actor, spec.obs_dim, spec.act_dim, sizes, actor_bound)
        critics = init_critics(
            key_critics, spec.obs_dim, spec.act_dim, sizes, self.num_critics, "none", critic_bound, hidden_bias=0.0
        )
        return TwinDelayedState.begin(actor, critics, metrics, models)

    def backed_up(self, batch: Transitions, next_values: Float[Array, " rows"]) -> Float[Array, " rows"]:
        """y of the values at s'."""
        return bellman_target(batch.rewards + self.reward_shift, batch.terminated, next_values, self.discount)

    def actor_rate(self, step: Int[Array, ""]) -> Number:
        """The actor's step size in the update after `step` updates; it falls with the steps of the actor."""
        taken = step // self.actor_delay * self.actor_delay
        return falling_rate(self.actor_learning_rate, taken, self.actor_decay_updates)
