"""What the estimators say of one policy, and whether the log bears a verdict (`odaf.estimation.judging`).

Estimators are not believed of a log for these reasons:

- weighing ones: fewer than 10 effective episodes;
- fitted Q and the model: the control fails: asked for the behaviour, they miss what it is known to have earned;
- the model: it leads the behaviour itself, too, mostly to states unlike the log's;
- drawn toward the log's own value: for the reasons of fitted Q;
- doubly robust: for the reasons of the weights or of fitted Q; the blend leaves out which fails, and fails with both.

What unlike states may earn is the model's to say. Without it, or where its control fails, no one knows where the
policy's actions lead, and all of these are refused if more than half of the actions are unlike the log's.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from odaf.components.behaviour_models import LARGEST_ACTION
from odaf.components.fitting import Batch, of_rows
from odaf.components.policies import Actor
from odaf.errors import DatasetError
from odaf.estimation.blend import blend, weights_of
from odaf.estimation.density import BehaviourDensity
from odaf.estimation.evidence import Evidence
from odaf.estimation.fitted_q import FittedQ
from odaf.estimation.importance import Weights
from odaf.estimation.judging import LARGEST_SHARE_UNLIKE, judged, why_thin
from odaf.estimation.outcomes import Unknown
from odaf.estimation.recorded import by_step
from odaf.estimation.settings import Acting
from odaf.estimation.shrinkage import shrink
from odaf.estimation.valuation import Interval, Valuation, ValueEstimate
from odaf.training.policy import Policy

FEWEST_EFFECTIVE_EPISODES = 10.0
WEIGHING = ("wis", "pdis", "dr")


@dataclass(frozen=True, eq=False)
class Judged:
    """A policy at the states of the log; actions are [rows, draws, act_dim] in [-1, 1]."""

    policy: Policy
    actions: np.ndarray
    next_actions: np.ndarray
    unweighed: str  # why its actions cannot be weighed by their probability, else ""
    unlike: float = 0.0


@dataclass(frozen=True, eq=False)
class ByMembers:
    """What the members of an ensemble say of a policy.

    Attributes:
        values: [discounts, 2, 1 + members], of the policy: what it earns, beside it the steps that an episode lasts;
            first the ensemble's, then every member's at the starts of its own episodes.
        behaviour: the same of the behaviour.
        figures: further numbers.
        strays: share of the behaviour's own steps that lead to states unlike the logged ones.
    """

    values: np.ndarray
    behaviour: np.ndarray
    figures: Mapping[str, float]
    strays: float = 0.0


class OfPolicy:
    """What is said of one policy; `fitted` is its Q and the behaviour's, `unknown` is by discount."""

    def __init__(
        self,
        log: Evidence,
        acting: Acting,
        judged: Judged,
        fitted: tuple[FittedQ, FittedQ] | None,
        modelled: ByMembers | None,
        unknown: Sequence[Unknown] | None,
        density: BehaviourDensity,
        log_probs: str | None,
    ) -> None:
        self.log, self.acting, self.judged, self.unknown = log, acting, judged, unknown
        self.fitted, self.density, self.log_probs = fitted, density, log_probs
        self.by_members: dict[str, ByMembers] = {}
        if fitted is not None:
            self.by_members["fqe"] = ByMembers(self._starts(0), self._starts(1), {"loss": fitted[0].loss})
        if modelled is not None:
            self.by_members["model"] = modelled

    def valuations(self, methods: tuple[str, ...]) -> tuple[Valuation, ...]:
        """One for each discount."""
        log, confidence = self.log, self.log.settings.confidence
        weighs = set(methods) & set(WEIGHING) and not self.judged.unweighed
        weights = self._weights() if weighs else None
        robust = self._tables() if weights is not None and "dr" in methods else None
        found = []
        for place, discount in enumerate(log.discounts):
            made: list[ValueEstimate] = []
            doubts = {name: self._doubts(name, place) for name in self.by_members}
            knows = None if self.unknown is None or doubts["model"] else self.unknown[place]
            if knows is None and self.judged.unlike > LARGEST_SHARE_UNLIKE:
                doubts = {name: [*each, why_thin(self.judged.unlike)] for name, each in doubts.items()}
            for name in methods:
                if name == "blend":
                    made.append(self._blended(place, doubts, knows))
                elif name == "shrunk":
                    made.append(self._shrunk(place, doubts["fqe"], knows))
                elif name in ("fqe", "model"):
                    made.append(self._by_members(name, place, doubts[name], knows))
                elif weights is None:
                    made.append(ValueEstimate(name, None, None, None, "refused", self.judged.unweighed))
                else:
                    own = replace(weights, recorded=log.recorded[place])
                    tables = None if robust is None else (robust[0][place], robust[1][place])
                    made.append(self._by_weights(name, own, tables, place, doubts.get("fqe", []), knows))
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
                    unlike_states=None if knows is None else knows.share,
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
        self,
        name: str,
        weights: Weights,
        tables: tuple[np.ndarray, np.ndarray] | None,
        place: int,
        doubts: list[str],
        knows: Unknown | None,
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
            unknown=knows if name == "dr" else None,
            figures={"complete_episodes": float(complete)} if name == "wis" else {},
            better=float(np.mean(value[1:] > own[1:])),
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

    # ---- members ------------------------------------------------------------------------------------------------

    def _starts(self, which: int) -> np.ndarray:
        """V of the policy (0) or the behaviour (1) at the first states: [discounts, 2, 1 + members].

        First the ensemble's, then every member's at its own episodes; beside it the steps that an episode lasts.
        """
        assert self.fitted is not None
        log, q = self.log, self.fitted[which]
        actions = self.judged.actions if which == 0 else log.actions[:, None]
        steps = np.full(len(log.starts), log.horizon)
        values = q.values(log.observations[log.starts], actions[log.starts], steps)
        own = np.sum(values * log.member_counts, axis=3) / np.sum(log.member_counts, axis=1)
        return np.concatenate([values.mean(axis=(2, 3))[..., None], own], axis=2)

    def _by_members(self, name: str, place: int, doubts: list[str], knows: Unknown | None) -> ValueEstimate:
        each, confidence = self.by_members[name], self.log.settings.confidence
        (value, length), control = each.values[place], each.behaviour[place, 0]
        above = value - control
        calibrated = self.log.own_of_members(place) + above
        return judged(
            name,
            Interval.of_members(float(value[0]), value[1:], confidence),
            Interval.of_members(*_per_step(value, length), confidence),
            Interval.of_members(float(above[0]), above[1:], confidence),
            doubts,
            unknown=knows,
            calibrated=Interval.of_members(float(calibrated[0]), calibrated[1:], confidence),
            figures={**each.figures, "control": float(control[0])},
            better=Interval.above_zero(float(above[0]), above[1:]),
        )

    def _shrunk(self, place: int, doubts: list[str], knows: Unknown | None) -> ValueEstimate:
        by_fqe = self._by_members("fqe", place, [], None)
        (value, length), own = self.by_members["fqe"].values[place], self.log.own[place][0]
        confidence = self.log.settings.confidence
        assert by_fqe.difference is not None
        found = shrink(
            by_fqe.difference,
            Interval.of_resamples(float(own[0]), own[1:], confidence),
            self.judged.unlike,
            members=len(value) - 1,
            episodes=self.log.dataset.num_episodes,
            confidence=confidence,
        )
        worth, steps = found.around(float(own[0]), confidence), float(length[0])
        return judged(
            "shrunk",
            worth,
            Interval(worth.value / steps, worth.low / steps, worth.high / steps),
            found.around(0.0, confidence),
            doubts,
            unknown=knows,
            figures={"weight_fqe": found.weight},
            better=found.better,
        )

    def _blended(self, place: int, doubts: Mapping[str, list[str]], knows: Unknown | None) -> ValueEstimate:
        believed = [name for name in ("fqe", "model") if not doubts[name]]
        names = believed or ["fqe", "model"]
        parts = [self.by_members[name] for name in names]
        above = [each.values[place, 0] - each.behaviour[place, 0] for each in parts]
        own, confidence = self.log.own_of_members(place), self.log.settings.confidence
        weights = weights_of(above, [float(each.behaviour[place, 0, 0] - own[0]) for each in parts])
        mean, apart = blend(above, weights)
        length, _ = blend([each.values[place, 1] for each in parts], weights)
        value = own + mean
        return judged(
            "blend",
            Interval.of_members(float(value[0]), value[1:], confidence, apart),
            Interval.of_members(*_per_step(value, length), confidence, apart / float(length[0])),
            Interval.of_members(float(mean[0]), mean[1:], confidence, apart),
            [] if believed else [*dict.fromkeys(doubts["fqe"] + doubts["model"])],
            unknown=knows,
            figures={f"weight_{name}": float(weight) for name, weight in zip(names, weights, strict=True)},
            better=Interval.above_zero(float(mean[0]), mean[1:], apart),
        )

    def _doubts(self, name: str, place: int) -> list[str]:
        """Why an ensemble should not be believed of this log; the behaviour's own value and states are the control."""
        confidence, strays = self.log.settings.confidence, self.by_members[name].strays
        if strays > LARGEST_SHARE_UNLIKE:
            return [
                f"{strays:.0%} of the states that the model leads whoever wrote the log to are unlike those that were "
                "logged: it does not hold for this log"
            ]
        of_behaviour = self.by_members[name].behaviour[place, 0]
        said = Interval.of_members(float(of_behaviour[0]), of_behaviour[1:], confidence)
        values = self.log.own[place][0]
        own = Interval.of_resamples(float(values[0]), values[1:], confidence)
        if said.high >= own.low and said.low <= own.high:
            return []
        what = {"fqe": "fitted Q gives", "model": "the model gives"}[name]
        return [f"{what} whoever wrote the log {said}, who earned {own}: it does not hold for this log"]

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


def _per_step(value: np.ndarray, length: np.ndarray) -> tuple[float, np.ndarray]:
    each = value / length
    return float(each[0]), each[1:]


def _log_density(actor: Actor, batch: Batch) -> Float[Array, " rows"]:
    return actor.log_density(batch[0], batch[1])
