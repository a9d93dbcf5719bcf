"""Policies beside a log: what the estimators say of each, and whether the log bears a verdict.

Fitted Q of the behaviour itself, whose value is known from the log, is fitted in the same program as the policies and
serves twice. It is the control: where it misses what the log earned, fitted Q does not hold for this log. And it
calibrates: to what the log earned is added by how much fitted Q puts the policy above the behaviour, member by member,
so that what it gets wrong for both cancels.

A verdict is given where the interval of the difference from the behaviour's own value leaves zero out. It is refused
where the log cannot bear one:

- weighing estimators: fewer than 10 effective episodes;
- fitted Q: more than half of the policy's actions are unlike any that the log shows (`odaf.estimation.density`), or the
  control fails;
- doubly robust: for any of these reasons.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.behaviour_models import LARGEST_ACTION
from odaf.components.fitting import Batch, Progress, of_rows
from odaf.components.policies import Actor
from odaf.errors import DatasetError
from odaf.estimation.compatibility import why_unweighed
from odaf.estimation.density import BehaviourDensity
from odaf.estimation.evidence import Evidence, Stages, draws, modes
from odaf.estimation.fitted_q import FittedQ, fit_q
from odaf.estimation.importance import Weights
from odaf.estimation.recorded import by_step
from odaf.estimation.settings import Acting
from odaf.estimation.valuation import Interval, Valuation, ValueEstimate, Verdict
from odaf.training.policy import Policy

FEWEST_EFFECTIVE_EPISODES = 10.0
LARGEST_SHARE_UNLIKE = 0.5
DRAWS = 4  # of the policy at each state, where draws are judged
WEIGHING = ("wis", "pdis", "dr")


@dataclass(frozen=True, eq=False)
class _Judged:
    """A policy at the states of the log; actions are [rows, draws, act_dim] in [-1, 1]."""

    policy: Policy
    actions: np.ndarray
    next_actions: np.ndarray
    unweighed: str  # why its actions cannot be weighed by their probability, else ""
    unlike: float = 0.0


class Beside:
    """Policies beside a log.

    Args:
        policies: to judge; on observations that are computed already.
        log: what they are judged by.
        acting: which of their actions.
        key: for draws of the policies and for what is fitted.
    """

    def __init__(self, policies: Sequence[Policy], log: Evidence, acting: Acting, key: PRNGKeyArray) -> None:
        self.log = log
        self.acting: Acting = acting
        key_actions, self.key_density, self.key_q, self.key_following = jr.split(key, 4)
        self.judged = []
        for number, policy in enumerate(policies):
            here, there = jr.split(jr.fold_in(key_actions, number))
            normalise = policy.normaliser.normalise
            now, later = (
                np.asarray(normalise(part), np.float32)
                for part in (log.dataset.observations, log.dataset.next_observations)
            )
            self.judged.append(
                _Judged(
                    policy,
                    self._act(policy.actor, now, here),
                    self._act(policy.actor, later, there),
                    why_unweighed(policy.actor, acting),
                )
            )

    def _act(self, actor: Actor, observations: np.ndarray, key: PRNGKeyArray) -> np.ndarray:
        """[rows, draws, act_dim]; one draw where the mode is judged."""
        columns = (jnp.asarray(observations), jnp.arange(len(observations)))
        if self.acting == "mode":
            return of_rows(modes, actor, columns)[:, None]
        return np.stack([of_rows(draws, (actor, each), columns) for each in jr.split(key, DRAWS)], axis=1)

    def valuations(
        self, methods: tuple[str, ...], log_probs: str | None, progress: Progress
    ) -> list[tuple[Valuation, ...]]:
        """For each policy a valuation at each discount; progress is told as it comes."""
        wants_q = "fqe" in methods or ("dr" in methods and any(not each.unweighed for each in self.judged))
        stages = Stages(progress, self.log.settings.steps, 2 if wants_q else 1)
        density = self.log.fitted_density(self.key_density, stages.next())
        fitted = self._fit(density, stages.next()) if wants_q else []
        found = []
        for number, judged in enumerate(self.judged):
            known = replace(judged, unlike=density.share_unlike(self.log.actions, judged.actions[:, 0]))
            own_q = (fitted[number], fitted[-1]) if wants_q else None
            found.append(_OfPolicy(self.log, self.acting, known, own_q, density, log_probs).valuations(methods))
        stages.finished()
        return found

    def _fit(self, density: BehaviourDensity, progress: Progress) -> list[FittedQ]:
        """Of every policy, and last of the behaviour."""
        log, settings = self.log, self.log.settings
        following = log.following_actions(density, self.key_following)[:, None]
        everyone = [each.next_actions for each in self.judged]
        everyone.append(np.broadcast_to(following, everyone[0].shape))
        return fit_q(
            log.rows(),
            np.stack(everyone),
            log.dataset.num_episodes,
            log.horizon,
            log.discounts,
            self.key_q,
            members=settings.members,
            progress=progress,
            **settings.fitting(),
        )


class _OfPolicy:
    """What is said of one policy; `fitted` is its Q and the behaviour's."""

    def __init__(
        self,
        log: Evidence,
        acting: Acting,
        judged: _Judged,
        fitted: tuple[FittedQ, FittedQ] | None,
        density: BehaviourDensity,
        log_probs: str | None,
    ) -> None:
        self.log, self.acting, self.judged = log, acting, judged
        self.fitted, self.density, self.log_probs = fitted, density, log_probs

    def valuations(self, methods: tuple[str, ...]) -> tuple[Valuation, ...]:
        """One for each discount."""
        log, confidence = self.log, self.log.settings.confidence
        weighs = set(methods) & set(WEIGHING) and not self.judged.unweighed
        weights = self._weights() if weighs else None
        states = None if self.fitted is None else [self._starts(0), self._starts(1)]
        robust = self._tables() if weights is not None and "dr" in methods else None
        found = []
        for place, discount in enumerate(log.discounts):
            made: list[ValueEstimate] = []
            doubts = [] if states is None else self._doubts(states[1][place], place)
            for name in methods:
                if name == "fqe":
                    assert states is not None
                    made.append(self._by_fitted_q(states[0][place], states[1][place], place, doubts))
                elif weights is None:
                    made.append(ValueEstimate(name, None, None, None, "refused", self.judged.unweighed))
                else:
                    own = replace(weights, recorded=log.recorded[place])
                    tables = None if robust is None else (robust[0][place], robust[1][place])
                    made.append(self._by_weights(name, own, tables, place, doubts))
            own, own_steps = log.own[place]
            found.append(
                Valuation(
                    policy=dict(self.judged.policy.provenance),
                    behaviour=Interval.of_resamples(float(own[0]), own[1:], confidence),
                    behaviour_per_step=Interval.of_resamples(*_per_step(own, own_steps), confidence),
                    estimates=tuple(made),
                    horizon=log.horizon,
                    discount=discount,
                    acting=self.acting,
                    episodes=log.dataset.num_episodes,
                    confidence=confidence,
                    unlike=self.judged.unlike,
                    notes=tuple(self._notes()),
                )
            )
        return tuple(found)

    # ---- weights ------------------------------------------------------------------------------------------------

    def _weights(self) -> Weights:
        """Weights from the policy's density and the behaviour's; both at the same actions."""
        log, policy = self.log, self.judged.policy
        seen = np.asarray(policy.normaliser.normalise(log.dataset.observations), np.float32)
        columns = (jnp.asarray(seen), jnp.asarray(log.actions))
        if self.log_probs is None:  # the fitted density cuts actions, so the policy's is asked for the same ones
            inside = jnp.clip(columns[1], -LARGEST_ACTION, LARGEST_ACTION)
            behaviour, columns = self.density.log_density(log.actions), (columns[0], inside)
        else:
            behaviour = self._logged_density(self.log_probs)
        ratios = of_rows(_log_density, policy.actor, columns).astype(np.float64) - behaviour
        return Weights.of(log.recorded[0], by_step(ratios[log.within], log.recorded[0].present))

    def _logged_density(self, name: str) -> np.ndarray:
        """Of actions in [-1, 1], from that of actions in the log's units."""
        dataset = self.log.dataset
        infos = dataset.infos
        if name not in infos or infos[name].shape != (len(dataset),):
            there = ", ".join(sorted(infos)) or "none"
            raise DatasetError(
                f"log_probs={name!r}: is no column of one number a row beside the data, which have {there}; "
                "leave it out, and the density is estimated"
            )
        return infos[name].astype(np.float64) + float(np.sum(np.log(self.log.half_ranges)))

    def _by_weights(
        self, name: str, weights: Weights, tables: tuple[np.ndarray, np.ndarray] | None, place: int, doubts: list[str]
    ) -> ValueEstimate:
        log, counts = self.log, self.log.counts
        if name == "dr":
            assert tables is not None
            rewards = weights.recorded.rewards, weights.recorded.present.astype(np.float64)
            value, length = (
                weights.doubly_robust(counts, column, *parts)
                for column, parts in zip(rewards, zip(*tables, strict=True), strict=True)
            )
        elif name == "wis":
            value, length = weights.whole_episodes(counts)
        else:
            value, length = weights.per_decision(counts)
        effective = weights.effective_episodes
        reasons = []
        if effective < FEWEST_EFFECTIVE_EPISODES:
            reasons.append(
                f"the weights leave {effective:.1f} effective episodes of {weights.recorded.episodes}, and at least "
                f"{FEWEST_EFFECTIVE_EPISODES:g} must speak: policy and log overlap too little, or too long"
            )
        reasons += doubts if name == "dr" else []
        complete = int(weights.recorded.complete.sum())
        if name == "wis" and complete < 2:
            reasons.append(f"{complete} episodes are known up to step {log.horizon}; give a lower horizon")
        own, confidence = log.own[place][0], log.settings.confidence
        return judged(
            name,
            Interval.of_resamples(float(value[0]), value[1:], confidence),
            Interval.of_resamples(*_per_step(value, length), confidence),
            Interval.of_resamples(float(value[0] - own[0]), value[1:] - own[1:], confidence),
            reasons,
            effective,
            figures={"complete_episodes": float(complete)} if name == "wis" else {},
        )

    def _tables(self) -> tuple[np.ndarray, np.ndarray]:
        """Q of logged actions and V of states, as `Weights.doubly_robust` takes them: [discounts, 2, E, H (+ 1)]."""
        assert self.fitted is not None
        log, rows, recorded, q = self.log, self.log.within, self.log.recorded[0], self.fitted[0]
        lengths = recorded.present.sum(axis=1)
        left = log.horizon - np.concatenate([np.arange(length) for length in lengths])
        taken = q.values(log.observations[rows], log.actions[rows][:, None], left).mean(axis=2)
        states = q.values(log.observations[rows], self.judged.actions[rows], left).mean(axis=2)
        shape = (*taken.shape[:2], recorded.episodes, log.horizon)
        of_actions, of_states = np.zeros(shape), np.zeros((*shape[:3], log.horizon + 1))
        of_actions[:, :, recorded.present] = taken
        of_states[:, :, :, :-1][:, :, recorded.present] = states
        cut = np.flatnonzero(~recorded.complete)
        if len(cut):
            last = log.starts[cut] + lengths[cut] - 1
            beyond = q.values(log.next_observations[last], self.judged.next_actions[last], log.horizon - lengths[cut])
            of_states[:, :, cut, lengths[cut]] = beyond.mean(axis=2)
        return of_actions, of_states

    # ---- fitted Q -----------------------------------------------------------------------------------------------

    def _starts(self, which: int) -> np.ndarray:
        """V of the policy (0) or the behaviour (1) at the first states: [discounts, 2, 1 + members].

        First the ensemble's, then every member's at its own episodes; beside it the steps that an episode lasts.
        """
        assert self.fitted is not None
        log, q = self.log, self.fitted[which]
        actions = self.judged.actions if which == 0 else log.actions[:, None]
        steps = np.full(len(log.starts), log.horizon)
        values = q.values(log.observations[log.starts], actions[log.starts], steps)
        own = np.sum(values * q.counts, axis=3) / np.sum(q.counts, axis=1)
        return np.concatenate([values.mean(axis=(2, 3))[..., None], own], axis=2)

    def _by_fitted_q(
        self, values: np.ndarray, of_behaviour: np.ndarray, place: int, doubts: list[str]
    ) -> ValueEstimate:
        assert self.fitted is not None
        confidence, (value, length) = self.log.settings.confidence, values
        above = value - of_behaviour[0]
        calibrated = self.log.own_of(place, self.fitted[0].counts) + above
        return judged(
            "fqe",
            Interval.of_members(float(value[0]), value[1:], confidence),
            Interval.of_members(*_per_step(value, length), confidence),
            Interval.of_members(float(above[0]), above[1:], confidence),
            doubts,
            calibrated=Interval.of_members(float(calibrated[0]), calibrated[1:], confidence),
            figures={"loss": self.fitted[0].loss, "control": float(of_behaviour[0, 0])},
        )

    def _doubts(self, of_behaviour: np.ndarray, place: int) -> list[str]:
        """Why fitted Q of this log should not be believed; the behaviour's own value is the control."""
        doubts, confidence = [], self.log.settings.confidence
        if self.judged.unlike > LARGEST_SHARE_UNLIKE:
            doubts.append(
                f"{self.judged.unlike:.0%} of the policy's actions are unlike any that the log shows at such states, "
                "so what they earn is a guess: the overlap is too thin"
            )
        said = Interval.of_members(float(of_behaviour[0, 0]), of_behaviour[0, 1:], confidence)
        values = self.log.own[place][0]
        own = Interval.of_resamples(float(values[0]), values[1:], confidence)
        if said.high < own.low or said.low > own.high:
            doubts.append(
                f"fitted Q gives whoever wrote the log {said}, who earned {own}: it does not hold for this log"
            )
        return doubts

    def _notes(self) -> list[str]:
        notes, log = [], self.log
        if self.judged.policy.provenance.get("data_rows_sha256") == log.dataset.fingerprint():
            notes.append(
                "the policy learned from this very log, so that estimates flatter it; set episodes aside before "
                "training with `odaf data split`"
            )
        cut = int((~log.recorded[0].complete).sum())
        if cut:
            notes.append(
                f"{cut} of {log.dataset.num_episodes} recordings were cut before step {log.horizon}; what came "
                "later there is taken from the other episodes"
            )
        return notes


def judged(
    name: str,
    value: Interval,
    per_step: Interval,
    difference: Interval,
    reasons: list[str],
    effective: float | None = None,
    *,
    calibrated: Interval | None = None,
    figures: Mapping[str, float],
) -> ValueEstimate:
    """An estimate with its verdict: refused where there are reasons, else by the interval of the difference."""
    verdict: Verdict = "refused" if reasons else "not decided"
    if not reasons and difference.low > 0.0:
        verdict = "better"
    elif not reasons and difference.high < 0.0:
        verdict = "worse"
    return ValueEstimate(name, value, per_step, difference, verdict, "; ".join(reasons), effective, calibrated, figures)


def _per_step(value: np.ndarray, length: np.ndarray) -> tuple[float, np.ndarray]:
    each = value / length
    return float(each[0]), each[1:]


def _log_density(actor: Actor, batch: Batch) -> Float[Array, " rows"]:
    return actor.log_density(batch[0], batch[1])
