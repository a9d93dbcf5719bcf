"""A policy beside a log: what the estimators say of it, and whether the log bears a verdict.

A verdict is given where the interval of the difference from the behaviour's own value leaves zero out. It is refused
where the log cannot bear one:

- weighing estimators: fewer than 10 effective episodes;
- fitted Q: more than half of the policy's actions are unlike any that the log shows (`odaf.estimation.density`), or
  fitted Q of the behaviour itself misses what the log says that it earned;
- doubly robust: for any of these reasons.
"""

from collections.abc import Callable, Mapping

import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.behaviour_models import LARGEST_ACTION
from odaf.components.fitting import Batch, Progress, of_rows
from odaf.components.policies import Actor
from odaf.data.dataset import Dataset
from odaf.data.normalisation import scale_actions
from odaf.errors import ConfigError, DatasetError
from odaf.estimation.density import BehaviourDensity, fit_density
from odaf.estimation.fitted_q import FittedQ, Transitions, fit_q
from odaf.estimation.importance import Weights
from odaf.estimation.recorded import Recorded, by_step, resampled, rows_within
from odaf.estimation.settings import Acting, EstimateSettings
from odaf.estimation.valuation import Interval, Valuation, ValueEstimate, Verdict
from odaf.training.policy import Policy

FEWEST_EFFECTIVE_EPISODES = 10.0
LARGEST_SHARE_UNLIKE = 0.5
DRAWS = 4  # of the policy at each state, where draws are judged
SAME_BOUNDS = 1e-5  # of the range


class Beside:
    """A policy beside a log: everything that several estimators need, in the policy's units."""

    def __init__(
        self,
        policy: Policy,
        dataset: Dataset,
        acting: Acting,
        horizon: int,
        discount: float,
        settings: EstimateSettings,
        key: PRNGKeyArray,
    ) -> None:
        _require_fit(policy, dataset)
        self.policy, self.dataset, self.acting, self.settings = policy, dataset, acting, settings
        key_actions, key_next, self.key_density, self.key_q, self.key_control, key_resamples = jr.split(key, 6)
        normalise = policy.normaliser.normalise
        self.observations = np.asarray(normalise(dataset.observations), np.float32)
        self.next_observations = np.asarray(normalise(dataset.next_observations), np.float32)
        scaled = scale_actions(dataset.actions, policy.action_low, policy.action_high)
        self.actions = np.clip(np.asarray(scaled, np.float32), -1.0, 1.0)
        self.policy_actions = self._act(self.observations, key_actions)
        self.next_actions = self._act(self.next_observations, key_next)
        self.episode = np.repeat(np.arange(dataset.num_episodes), dataset.episode_lengths())
        self.recorded = Recorded.of(dataset, horizon, discount)
        self.within = rows_within(dataset, horizon)
        rng = np.random.default_rng(np.asarray(jr.bits(key_resamples, (4,))))
        self.counts = resampled(dataset.num_episodes, settings.resamples, rng)
        self.own, self.own_steps = self.recorded.values(self.counts)

    def _act(self, observations: np.ndarray, key: PRNGKeyArray) -> np.ndarray:
        """[rows, draws, act_dim]; one draw where the mode is judged."""
        columns = (jnp.asarray(observations), jnp.arange(len(observations)))
        if self.acting == "mode":
            return of_rows(_modes, self.policy.actor, columns)[:, None]
        keys = jr.split(key, DRAWS)
        return np.stack([of_rows(_draws, (self.policy.actor, each), columns) for each in keys], axis=1)

    def valuation(
        self, methods: tuple[str, ...], weighing: str, log_probs: str | None, progress: Progress
    ) -> Valuation:
        """All estimates, told to `progress` as they come."""
        recorded, confidence = self.recorded, self.settings.confidence
        wants_q = "fqe" in methods or ("dr" in methods and not weighing)
        stages = _Stages(progress, self.settings.steps, 3 if wants_q else 1)
        density = fit_density(
            self.observations,
            self.actions,
            self.episode,
            self.key_density,
            progress=stages.next(),
            patience=self.settings.patience,
            **self.settings.fitting(),
        )
        unlike = density.share_unlike(self.actions, self.policy_actions[:, 0])
        fitted, doubts = None, []
        if wants_q:
            fitted = self._fit(self.next_actions, np.ones(len(self.dataset), bool), self.key_q, stages.next())
            doubts = self._doubts(unlike, stages.next())
        weights = None if weighing or methods == ("fqe",) else self._weights(density, log_probs)
        made: list[ValueEstimate] = []
        for name in methods:
            if name == "fqe" and fitted is not None:
                made.append(self._by_fitted_q(fitted, doubts))
            elif weights is None:
                made.append(ValueEstimate(name, None, None, None, "refused", weighing))
            else:
                made.append(self._by_weights(name, weights, fitted, doubts))
        stages.finished()
        return Valuation(
            policy=dict(self.policy.provenance),
            behaviour=Interval.of_resamples(float(self.own[0]), self.own[1:], confidence),
            behaviour_per_step=Interval.of_resamples(*_per_step(self.own, self.own_steps), confidence),
            estimates=tuple(made),
            horizon=recorded.horizon,
            discount=recorded.discount,
            acting=self.acting,
            episodes=recorded.episodes,
            confidence=confidence,
            unlike=unlike,
            notes=tuple(self._notes()),
        )

    # ---- weights ------------------------------------------------------------------------------------------------

    def _weights(self, density: BehaviourDensity, log_probs: str | None) -> Weights:
        """Weights from the policy's density and the behaviour's; both at the same actions."""
        columns = (jnp.asarray(self.observations), jnp.asarray(self.actions))
        if log_probs is None:  # the fitted density cuts actions, so the policy's is asked for the same ones
            inside = jnp.clip(columns[1], -LARGEST_ACTION, LARGEST_ACTION)
            behaviour, columns = density.log_density(self.actions), (columns[0], inside)
        else:
            behaviour = self._logged_density(log_probs)
        ratios = of_rows(_log_density, self.policy.actor, columns).astype(np.float64) - behaviour
        return Weights.of(self.recorded, by_step(ratios[self.within], self.recorded.present))

    def _logged_density(self, name: str) -> np.ndarray:
        """Of actions in [-1, 1], from that of actions in the log's units."""
        infos = self.dataset.infos
        if name not in infos or infos[name].shape != (len(self.dataset),):
            there = ", ".join(sorted(infos)) or "none"
            raise DatasetError(
                f"log_probs={name!r}: is no column of one number a row beside the data, which have {there}; "
                "leave it out, and the density is estimated"
            )
        half = (np.asarray(self.policy.action_high) - np.asarray(self.policy.action_low)) / 2.0
        return infos[name].astype(np.float64) + float(np.sum(np.log(half)))

    def _by_weights(self, name: str, weights: Weights, fitted: FittedQ | None, doubts: list[str]) -> ValueEstimate:
        if name == "dr":
            assert fitted is not None
            value, length = self._doubly_robust(weights, fitted)
        elif name == "wis":
            value, length = weights.whole_episodes(self.counts)
        else:
            value, length = weights.per_decision(self.counts)
        effective = weights.effective_episodes
        reasons = []
        if effective < FEWEST_EFFECTIVE_EPISODES:
            reasons.append(
                f"the weights leave {effective:.1f} effective episodes of {self.recorded.episodes}, and at least "
                f"{FEWEST_EFFECTIVE_EPISODES:g} must speak: policy and log overlap too little, or too long"
            )
        reasons += doubts if name == "dr" else []
        complete = int(self.recorded.complete.sum())
        if name == "wis" and complete < 2:
            reasons.append(f"{complete} episodes are known up to step {self.recorded.horizon}; give a lower horizon")
        per_step = Interval.of_resamples(*_per_step(value, length), self.settings.confidence)
        return self._judged(
            name,
            Interval.of_resamples(float(value[0]), value[1:], self.settings.confidence),
            per_step,
            Interval.of_resamples(float(value[0] - self.own[0]), value[1:] - self.own[1:], self.settings.confidence),
            reasons,
            effective,
            {"complete_episodes": float(complete)} if name == "wis" else {},
        )

    def _doubly_robust(self, weights: Weights, fitted: FittedQ) -> tuple[np.ndarray, np.ndarray]:
        recorded, rows = self.recorded, self.within
        lengths = recorded.present.sum(axis=1)
        left = recorded.horizon - np.concatenate([np.arange(length) for length in lengths])
        taken = fitted.values(self.observations[rows], self.actions[rows][:, None], left).mean(axis=1)
        states = fitted.values(self.observations[rows], self.policy_actions[rows], left).mean(axis=1)
        cut = np.flatnonzero(~recorded.complete)
        last = self.dataset.episode_starts[cut] + lengths[cut] - 1
        found = []
        for output, rewards in enumerate((recorded.rewards, recorded.present.astype(np.float64))):
            action_values = by_step(taken[output], recorded.present)
            state_values = np.zeros((recorded.episodes, recorded.horizon + 1))
            state_values[:, :-1] = by_step(states[output], recorded.present)
            if len(cut):
                beyond = fitted.values(
                    self.next_observations[last], self.next_actions[last], recorded.horizon - lengths[cut]
                )
                state_values[cut, lengths[cut]] = beyond[output].mean(axis=0)
            found.append(weights.doubly_robust(self.counts, rewards, action_values, state_values))
        return found[0], found[1]

    # ---- fitted Q -----------------------------------------------------------------------------------------------

    def _fit(self, next_actions: np.ndarray, rows: np.ndarray, key: PRNGKeyArray, progress: Progress) -> FittedQ:
        everything = Transitions(
            self.observations,
            self.actions,
            self.dataset.rewards.astype(np.float64),
            self.dataset.terminated,
            self.next_observations,
            next_actions,
            self.episode,
        )
        return fit_q(
            everything.at(np.flatnonzero(rows)),
            self.dataset.num_episodes,
            self.recorded.horizon,
            self.recorded.discount,
            key,
            members=self.settings.members,
            progress=progress,
            **self.settings.fitting(),
        )

    def _start_values(self, fitted: FittedQ, actions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """V of every member at the first states of its own episodes, before that the ensemble's at all: [1 + members].

        Beside it the steps that an episode lasts.
        """
        starts = self.dataset.episode_starts
        steps = np.full(len(starts), self.recorded.horizon)
        values = fitted.values(self.observations[starts], actions[starts], steps)
        own = np.sum(values * fitted.counts, axis=2) / np.sum(fitted.counts, axis=1)
        return tuple(np.concatenate([[each.mean()], member]) for each, member in zip(values, own, strict=True))  # type: ignore

    def _by_fitted_q(self, fitted: FittedQ, doubts: list[str]) -> ValueEstimate:
        value, length = self._start_values(fitted, self.policy_actions)
        beside, _ = self.recorded.values(np.concatenate([np.ones((1, self.recorded.episodes)), fitted.counts]))
        confidence = self.settings.confidence
        return self._judged(
            "fqe",
            Interval.of_members(float(value[0]), value[1:], confidence),
            Interval.of_members(*_per_step(value, length), confidence),
            Interval.of_members(float(value[0] - beside[0]), value[1:] - beside[1:], confidence),
            doubts,
            None,
            {"loss": fitted.loss},
        )

    def _doubts(self, unlike: float, progress: Progress) -> list[str]:
        """Why fitted Q of this log should not be believed; the behaviour's own value is the control."""
        doubts = []
        if unlike > LARGEST_SHARE_UNLIKE:
            doubts.append(
                f"{unlike:.0%} of the policy's actions are unlike any that the log shows at such states, so what they "
                "earn is a guess: the overlap is too thin"
            )
        last = np.append(self.dataset.episode_starts[1:], len(self.dataset)) - 1
        following = np.concatenate([self.actions[1:], np.zeros_like(self.actions[:1])])
        known = np.ones(len(self.dataset), bool)
        known[last] = self.dataset.terminated[last]
        control = self._fit(following[:, None], known, self.key_control, progress)
        value, _ = self._start_values(control, self.actions[:, None])
        said = Interval.of_members(float(value[0]), value[1:], self.settings.confidence)
        own = Interval.of_resamples(float(self.own[0]), self.own[1:], self.settings.confidence)
        if said.high < own.low or said.low > own.high:
            doubts.append(
                f"fitted Q gives whoever wrote the log {said}, who earned {own}: it does not hold for this log"
            )
        return doubts

    # ---- verdicts -----------------------------------------------------------------------------------------------

    def _judged(
        self,
        name: str,
        value: Interval,
        per_step: Interval,
        difference: Interval,
        reasons: list[str],
        effective: float | None,
        figures: Mapping[str, float],
    ) -> ValueEstimate:
        verdict: Verdict = "refused" if reasons else "not decided"
        if not reasons and difference.low > 0.0:
            verdict = "better"
        elif not reasons and difference.high < 0.0:
            verdict = "worse"
        return ValueEstimate(name, value, per_step, difference, verdict, "; ".join(reasons), effective, figures)

    def _notes(self) -> list[str]:
        notes = []
        if self.policy.provenance.get("data_rows_sha256") == self.dataset.fingerprint():
            notes.append(
                "the policy learned from this very log, so that estimates flatter it; set episodes aside before "
                "training with `odaf data split`"
            )
        cut = int((~self.recorded.complete).sum())
        if cut:
            notes.append(
                f"{cut} of {self.recorded.episodes} recordings were cut before step {self.recorded.horizon}; what came "
                "later there is taken from the other episodes"
            )
        return notes


class _Stages:
    """Several fits as one progress."""

    def __init__(self, progress: Progress, steps: int, stages: int) -> None:
        self.progress, self.steps, self.stages, self.done = progress, steps, stages, 0

    def next(self) -> Callable[[int, int], None]:
        """The progress of the next fit."""
        before, self.done = self.done * self.steps, self.done + 1
        return lambda done, total: self.progress(before + done, self.stages * self.steps)

    def finished(self) -> None:
        """All is done, though a fit may have stopped early."""
        self.progress(self.stages * self.steps, self.stages * self.steps)


def _require_fit(policy: Policy, dataset: Dataset) -> None:
    if policy.has_memory:
        raise ConfigError(
            f"{type(policy.actor).__name__}: remembers earlier steps, and estimates ask for actions at single states; "
            "play such a policy with `odaf evaluate`"
        )
    for what, mine, theirs in (
        ("observations", policy.observation_names, dataset.observation_names),
        ("actions", policy.action_names, dataset.action_names),
    ):
        if mine and mine != theirs:
            raise DatasetError(
                f"{what}: the policy has {', '.join(mine)}, the log {', '.join(theirs)}; read the log as the one that "
                "the policy learned from, in the same order"
            )
    if (policy.obs_dim, policy.act_dim) != (dataset.obs_dim, dataset.act_dim):
        raise DatasetError(
            f"the policy takes {policy.obs_dim} observations and gives {policy.act_dim} actions, the log has "
            f"{dataset.obs_dim} and {dataset.act_dim}; give a log of the same plant"
        )
    low, high = np.asarray(policy.action_low), np.asarray(policy.action_high)
    off = np.abs(np.stack([low - dataset.action_low, high - dataset.action_high])) > SAME_BOUNDS * (high - low)
    if off.any():
        raise DatasetError(
            f"actions: the policy's bounds are {low.tolist()} to {high.tolist()}, the log's "
            f"{dataset.action_low.tolist()} to {dataset.action_high.tolist()}; set the hold-out aside from one log "
            "with `odaf data split`, or read it with action_bounds="
        )
    if dataset.num_episodes < 2:
        raise DatasetError("the log has a single episode, and intervals are over episodes; log more of them")


def _per_step(value: np.ndarray, length: np.ndarray) -> tuple[float, np.ndarray]:
    each = value / length
    return float(each[0]), each[1:]


def _modes(actor: Actor, batch: Batch) -> Float[Array, "rows act_dim"]:
    return actor.mode(batch[0])


def _draws(model: tuple[Actor, PRNGKeyArray], batch: Batch) -> Float[Array, "rows act_dim"]:
    actor, key = model
    observations, rows = batch
    return actor.act(actor.begin(observations.shape[0]), observations, jr.fold_in(key, rows[0]))[0]


def _log_density(actor: Actor, batch: Batch) -> Float[Array, " rows"]:
    return actor.log_density(batch[0], batch[1])
