"""MBRCSL: imitation of imagined episodes that earn more than any logged one (Zhou et al. 2024).

    1. (s', r) ~ an ensemble of the log's transitions           `components/dynamics/transition_ensemble.py`
    2. a ~ pi_b(.|s), by denoising                              `components/diffusion.py`
    3. s_0 of a logged episode, a_t ~ pi_b(.|s_t), (s_{t+1}, r_t) of a random elite, for as long as an episode lasts;
       kept whole where R = sum_t r_t > max_{logged episodes} sum_t r_t
       g_t = R - sum_{j < t} r_j
    4. L = mean_{B, dims} ( pi(s_t, g_t) - a_t )^2 over the kept episodes alone
       gradient of L + w / 2 ||theta||^2 into Adam

    acting: g_0 = max R of the kept episodes,  a = clip( pi(s, g), -1, 1 ),  g <- g - r with the reward that is earned

Nothing bootstraps: no critic, no discount. Stages 1 to 3 come before the first update, stage 4 is what updates do. Of
the kept episodes a tenth is held out. Every `refresh_every` updates their error is looked at; the policy is the one
that had the lowest, and after `earliest_stop` updates it is settled once so many looks in a row brought no gain of 1 %.

Differs from the paper and its code: observations are normalised. The denoising network is a plain one, which sees s and
the step beside the noised action, in place of a U-Net; its step size falls at each of its updates, where the code's
schedule moves once an epoch and so never leaves its warm-up. Exactly `num_rollouts` episodes are kept; after
`max_rounds` the best others fill what is missing, where the code goes on. With `within_log` imagined states and rewards
are cut to the range that the log shows; the code lets them go anywhere. Episodes are held out whole, and the lowest
error counts from the start. Rollouts last as long as the longest logged episode and do not end before.
"""

import dataclasses
import functools
import time
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms import citations
from odaf.algorithms.base import Algorithm, LearnerState, Metrics, PretrainProgress
from odaf.components.diffusion_fit import DiffusionConfig, fit_action_diffusion
from odaf.components.dynamics import EnsembleConfig, fit_transitions
from odaf.components.imagined import Imagined, Range, keep, report_of, returns_to_go, rounds_of
from odaf.components.networks import MLP, init_mlp
from odaf.components.numbers import Number
from odaf.components.return_conditioned import ReturnConditionedActor
from odaf.components.trained import Trained
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.data.row_choice import drawn_from
from odaf.data.sampling import Columns
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import View
from odaf.errors import ConfigError

LEAST_GAIN = 0.01  # share of the lowest hold-out error that a new one must be lower by
HEAD_GAIN = 0.01  # of the Xavier initialisation of the policy's last layer


class MBRCSLState(LearnerState):
    """State of MBRCSL."""

    step: Int[Array, ""]
    network: Trained[MLP]  # of the policy; no slow copy
    imagined: Imagined  # the last ones are held out
    start: Float[Array, ""]  # g_0
    mean: Float[Array, ""]  # of g, as the policy sees it
    std: Float[Array, ""]
    best: MLP  # the one with the lowest hold-out error
    lowest: Float[Array, ""]  # that error
    looks: Int[Array, ""]  # without a gain
    settled: Bool[Array, ""]

    def actor(self, network: MLP) -> ReturnConditionedActor:
        """The policy of a network."""
        return ReturnConditionedActor(network, self.start, self.mean, self.std)


def imitation_loss(
    actor: ReturnConditionedActor,
    observations: Float[Array, "rows obs_dim"],
    returns: Float[Array, " rows"],
    actions: Float[Array, "rows act_dim"],
) -> Float[Array, ""]:
    """L, of actions that are not cut to [-1, 1]."""
    return jnp.mean(jnp.square(actor.actions(observations, returns) - actions))


def decayed(gradient: MLP, network: MLP, weight: Number) -> MLP:
    """The gradient of L + weight / 2 ||theta||^2, weights and biases alike, from that of L."""
    return jax.tree.map(lambda slope, leaf: slope + weight * leaf, gradient, network)


@dataclasses.dataclass(frozen=True)
class MBRCSL(Algorithm[MBRCSLState]):
    """Model-based return-conditioned supervised learning."""

    kind: ClassVar[str] = "mbrcsl"
    structural: ClassVar[frozenset[str]] = frozenset({"normaliser_epsilon", "holdout"})

    num_rollouts: int = 100
    """Imagined episodes that the policy learns from."""
    round_size: int = 200
    """Episodes that are imagined at once."""
    max_rounds: int = 100
    """Rounds after which the best episodes are taken although too few earn more than the best logged one."""
    within_log: bool = True
    """Whether imagined states and rewards are cut to the range that the log shows, so that nobody passes its walls;
    False takes what the dynamics dream."""
    rollout_steps: int | None = None
    """Length of an imagined episode; None takes that of the longest logged one."""
    hidden_sizes: tuple[int, ...] = (1024, 1024)
    """Widths of the policy's hidden layers."""
    normalise_returns: bool = True
    """Whether the policy sees the return that is left in the spread of the imagined ones; False as it is."""
    learning_rate: float = 5e-5
    """Step size of Adam for the policy."""
    weight_decay: float = 1e-3
    """w: of the parameters in the policy's gradient (L2 regularisation)."""
    batch_size: int = 256
    """Imagined steps a gradient step."""
    holdout: float = 0.1
    """Share of the imagined episodes kept out of the policy's training, by whose error it is chosen."""
    refresh_every: int = 70
    """Updates between two looks at that error."""
    patience: int | None = 5
    """Looks in a row without a gain after which the policy is settled; None takes the one of the last update."""
    earliest_stop: int = 5_600
    """Updates before these looks are counted."""
    normaliser_epsilon: float = 0.0
    """Added to the standard deviations that observations are divided by, in their own units."""
    dynamics: EnsembleConfig = dataclasses.field(default_factory=EnsembleConfig)
    """Of the ensemble of transitions."""
    behaviour: DiffusionConfig = dataclasses.field(default_factory=DiffusionConfig)
    """Of the model of whoever acted in the log."""

    def __post_init__(self) -> None:
        least = {"num_rollouts": 2, "round_size": 1, "max_rounds": 1, "batch_size": 1, "refresh_every": 1}
        for field, smallest in least.items():
            if getattr(self, field) < smallest:
                raise ConfigError(f"{field}={getattr(self, field)} must be at least {smallest}")
        for field in ("rollout_steps", "patience"):
            count = getattr(self, field)
            if count is not None and count < 1:
                raise ConfigError(f"{field}={count} must be at least 1, or none")
        if self.round_size * self.max_rounds < self.num_rollouts:
            raise ConfigError(
                f"num_rollouts={self.num_rollouts}: only {self.round_size * self.max_rounds} are imagined in "
                f"{self.max_rounds} rounds of {self.round_size}; raise round_size or max_rounds"
            )
        if self.weight_decay < 0.0:
            raise ConfigError(f"weight_decay={self.weight_decay} must not be negative")
        if not 0.0 < self.holdout < 1.0:
            raise ConfigError(f"holdout={self.holdout} must lie between 0 and 1: they choose the policy")
        if self.normaliser_epsilon < 0.0:
            raise ConfigError(f"normaliser_epsilon={self.normaliser_epsilon} must not be negative")

    def citations(self) -> tuple[citations.Citation, ...]:
        """MBRCSL, and the denoising that its behaviour model is."""
        return (citations.MBRCSL, citations.DENOISING_DIFFUSION)

    def view(self) -> View:
        """Single rows with the reward as logged; updates see none of them."""
        return View(normaliser_epsilon=self.normaliser_epsilon)

    def sizes(self, spec: Spec) -> tuple[int, ...]:
        """How long an imagined episode is."""
        return (self.rollout_steps or spec.max_episode_length,)

    # ---- before the first update ----------------------------------------------------------------------------------

    def untrained(self, key: PRNGKeyArray, spec: Spec) -> Imagined:
        """Episodes of the right size in which nothing happens."""
        del key
        shape = self.num_rollouts, *self.sizes(spec)
        return Imagined(jnp.zeros((*shape, spec.obs_dim)), jnp.zeros((*shape, spec.act_dim)), jnp.zeros(shape))

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[Imagined, dict[str, Any]]:
        """Stages 1 to 3; the report has one entry for each, with its seconds.

        Raises:
            DivergenceError: a model's loss, or what it imagines, stopped being finite.
            DatasetError: the log has too few rows to learn a model from.
        """
        key_dynamics, key_behaviour, key_rollouts, key_order = jr.split(key, 4)
        view = self.drawn_view()
        seconds = [time.perf_counter()]
        dynamics, of_dynamics = fit_transitions(
            self.dynamics, dataset, normaliser, key_dynamics, functools.partial(progress, "dynamics")
        )
        seconds.append(time.perf_counter())
        imitated = drawn_from(dataset, view.choice)
        behaviour, of_behaviour = fit_action_diffusion(
            self.behaviour, imitated, normaliser, view, key_behaviour, functools.partial(progress, "behaviour model")
        )
        seconds.append(time.perf_counter())
        starts = normaliser.normalise(dataset.observations[dataset.episode_starts])
        bar = float(dataset.episode_returns().max())
        known = Range.of(normaliser.normalise(dataset.observations), dataset.rewards)
        bounds = known if self.within_log else Range.endless(dataset.obs_dim)
        rounds = rounds_of(
            dynamics,
            behaviour,
            bounds,
            starts,
            key_rollouts,
            self.max_rounds,
            self.round_size,
            *self.sizes(dataset.spec()),
        )
        kept = keep(rounds, bar, self.num_rollouts, functools.partial(progress, "rollouts"))
        order = np.asarray(jr.permutation(key_order, self.num_rollouts))  # so that any of them may be held out
        chosen = kept.rollouts.taken(order)
        imagined = Imagined(*map(jnp.asarray, (*chosen[:2], returns_to_go(chosen.rewards))))
        seconds.append(time.perf_counter())
        reports = {
            "dynamics": of_dynamics,
            "behaviour": of_behaviour,
            "rollouts": report_of(kept, bar, known, dataset.spec()),
        }
        warnings = [sentence for report in reports.values() for sentence in report.pop("warnings")]
        for report, took in zip(reports.values(), np.diff(seconds).tolist(), strict=True):
            report["seconds"] = took
        return imagined, {**reports, "warnings": warnings}

    # ---- updates --------------------------------------------------------------------------------------------------

    def init(self, key: PRNGKeyArray, spec: Spec, models: PyTree) -> MBRCSLState:
        """Random policy, asked for the highest return that was imagined; fresh optimiser."""
        imagined: Imagined = models
        sizes = spec.obs_dim + 1, *self.hidden_sizes, spec.act_dim
        bound = HEAD_GAIN * (6.0 / (sizes[-2] + sizes[-1])) ** 0.5
        network = init_mlp(key, sizes, hidden_bias=0.0, output_bound=bound)
        network = eqx.tree_at(lambda mlp: mlp.biases[-1], network, jnp.zeros(spec.act_dim))
        returns = imagined.returns_to_go
        mean, std = jnp.zeros(()), jnp.ones(())
        if self.normalise_returns:
            mean, std = jnp.mean(returns), jnp.std(returns)
            std = jnp.where(std > 0.0, std, 1.0)
        state = MBRCSLState(
            jnp.asarray(0),
            Trained.begin(network, slow=False),
            imagined,
            jnp.max(returns[:, 0]),
            mean,
            std,
            network,
            jnp.zeros(()),
            jnp.asarray(0),
            jnp.asarray(False),
        )
        return dataclasses.replace(state, lowest=self.holdout_error(state, network))

    def batch(self, state: MBRCSLState, columns: Columns, key: PRNGKeyArray) -> Transitions:
        """Imagined steps that are not held out; g is in `extras`, and there is nothing else that updates look at."""
        del columns
        (observations, actions, returns), _ = self._parts(state.imagined)
        rows = jr.randint(key, (self.batch_size,), 0, returns.shape[0])
        seen, nothing = observations[rows], jnp.zeros(self.batch_size)
        return Transitions(seen, actions[rows], nothing, seen, nothing, {"returns_to_go": returns[rows]})

    def refresh(self, state: MBRCSLState, columns: Columns, key: PRNGKeyArray) -> MBRCSLState:
        """A look at the hold-out error."""
        del columns, key
        return self.looked_at(state)

    def looked_at(self, state: MBRCSLState) -> MBRCSLState:
        """The state after a look at the hold-out error: the best policy, and whether it is settled."""
        error = self.holdout_error(state, state.network.now)
        gains = ~state.settled & (error < (1.0 - LEAST_GAIN) * state.lowest)
        looks = jnp.where(gains | (state.step < self.earliest_stop), 0, state.looks + 1)
        settled = state.settled if self.patience is None else state.settled | (looks >= self.patience)
        best = jax.tree.map(lambda new, old: jnp.where(gains, new, old), state.network.now, state.best)
        lowest = jnp.where(gains, error, state.lowest)
        return dataclasses.replace(state, best=best, lowest=lowest, looks=looks, settled=settled)

    def update(self, state: MBRCSLState, batch: Transitions, key: PRNGKeyArray) -> tuple[MBRCSLState, Metrics]:
        """One Adam step on L with its L2 term."""
        del key
        network = state.network.now

        def loss_of(network: MLP) -> Float[Array, ""]:
            actor = state.actor(network)
            return imitation_loss(actor, batch.observations, batch.extras["returns_to_go"], batch.actions)

        loss, gradient = jax.value_and_grad(loss_of)(network)
        trained = state.network.stepped(decayed(gradient, network, self.weight_decay), self.learning_rate)
        metrics = {"actor/loss": loss, "actor/holdout_error": state.lowest, "return_to_go/start": state.start}
        return dataclasses.replace(state, step=state.step + 1, network=trained), metrics

    def actor(self, state: MBRCSLState) -> ReturnConditionedActor:
        """The policy with the lowest hold-out error, the present one among them; without patience the present one."""
        return state.actor(state.network.now if self.patience is None else self.looked_at(state).best)

    def holdout_error(self, state: MBRCSLState, network: MLP) -> Float[Array, ""]:
        """L on the imagined episodes that are held out."""
        _, (observations, actions, returns) = self._parts(state.imagined)
        return imitation_loss(state.actor(network), observations, returns, actions)

    def _parts(self, imagined: Imagined) -> tuple[tuple[Array, Array, Array], tuple[Array, Array, Array]]:
        """(states, actions, returns-to-go) of all steps to learn from, and of those held out."""
        held = min(max(round(self.holdout * self.num_rollouts), 1), self.num_rollouts - 1)
        columns = imagined.observations, imagined.actions, imagined.returns_to_go

        def flat(rollouts: slice) -> tuple[Array, Array, Array]:
            states, actions, returns = (column[rollouts].reshape(-1, *column.shape[2:]) for column in columns)
            return states, actions, returns

        return flat(slice(None, -held)), flat(slice(-held, None))
