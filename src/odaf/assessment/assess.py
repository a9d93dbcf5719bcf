"""The front of an assessment: what is asked of the log, and in which order."""

import dataclasses
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from odaf.assessment import actions, after
from odaf.assessment.conditions import Condition, Kept, conditions_of, share_of
from odaf.assessment.verdict import reservations, verdict_of
from odaf.components.fitting import Progress
from odaf.data.checks.findings import Report
from odaf.data.dataset import Dataset
from odaf.deployment.guard import GuardedPolicy
from odaf.deployment.make_guard import guard as make_guard
from odaf.errors import ConfigError, DatasetError
from odaf.estimation import EstimateSettings, Interval, Valuation, ValueEstimate, estimate
from odaf.estimation.estimate import policy_of
from odaf.estimation.valuation import Verdict
from odaf.training.files import plain
from odaf.training.policy import Policy

DECIDES = "blend"
"""Estimator by which verdict and conditions go."""


@dataclass(frozen=True, eq=False)
class Assessment:
    """What a log says of a policy.

    Attributes:
        verdict: "better", "worse", "not decided" or "refused", than whoever wrote the log.
        reasons: why, as sentences.
        reservations: what to look at besides.
        valuation: values by every estimator that can judge a deployed policy.
        kept: conditions, logged and to be expected of the policy.
        columns: actions beside the logged ones.
        guard: calibrated on the hold-out; None where none could be made.
        no_guard: why there is none, else an empty text.
        over_time: guard's score beside its threshold in the hold-out episode with the highest one, [steps] of the
            logged actions and of the policy's own in the same states; None without a guard.
        report: what the checks say of the hold-out.
        holdout: the hold-out.
        own: [N, act_dim], the policy's actions in its states.
        policy: what was judged.
        seed: of everything random.
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    reservations: tuple[str, ...]
    valuation: Valuation
    kept: tuple[Kept, ...]
    columns: tuple[actions.ActionColumn, ...]
    guard: GuardedPolicy | None
    no_guard: str
    over_time: tuple[np.ndarray, np.ndarray] | None
    report: Report
    holdout: Dataset
    own: np.ndarray
    policy: Policy
    seed: int

    @property
    def decisive(self) -> ValueEstimate:
        """The estimate that the verdict goes by."""
        return self.valuation[DECIDES]

    @property
    def promised(self) -> Interval | None:
        """Value of an episode of the policy, in the log's unit of reward; None where the estimate was refused."""
        found = self.decisive
        return None if found.verdict == "refused" else found.calibrated or found.value

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types; NaN as None."""
        guarded = None if self.guard is None else self.guard.to_dict()
        return plain(
            {
                "verdict": self.verdict,
                "reasons": list(self.reasons),
                "reservations": list(self.reservations),
                "decides": DECIDES,
                "value": self.valuation.to_dict(),
                "keep": [dataclasses.asdict(each) | {"worse": each.worse} for each in self.kept],
                "actions": [actions.to_dict(column) for column in self.columns],
                "guard": guarded,
                "no_guard": self.no_guard,
                "checks": self.report.to_dict(),
                "holdout_sha256": self.holdout.fingerprint(),
                "seed": self.seed,
            }
        )

    def __str__(self) -> str:
        lines = [f"{self.verdict.upper()}: {'; '.join(self.reasons)}", ""]
        lines.append(
            f"value of an episode: {self.promised or 'refused'} ({DECIDES}); whoever wrote the log "
            f"{self.valuation.behaviour}; to step {self.valuation.horizon:,}, {self.valuation.confidence:.0%} intervals"
        )
        lines += [str(each) for each in self.kept]
        for column in self.columns:
            unit = f" {column.unit}" if column.unit else ""
            lines.append(
                f"action {column.name}: {column.outside:.1%} beyond the logged range; usual change a step "
                f"{column.policy_change[1]:.3g}{unit}, logged {column.logged_change[1]:.3g}{unit}"
            )
        if self.guard is None:
            lines.append(f"no guard: {self.no_guard}")
        else:
            calibration, facts = self.guard.calibration, self.guard.facts
            lines.append(
                f"guard: false alarms in at most {calibration.promised:.2%} of episodes, promised by "
                f"{calibration.episodes:,}; with the policy's own actions {facts['policy_alarms']:,} of them have one"
            )
        lines += [f"look at: {each}" for each in self.reservations]
        return "\n".join(lines)


def assess(
    run: Policy | str | os.PathLike[str],
    holdout: Dataset | str | os.PathLike[str],
    *,
    keep: Sequence[str] = (),
    log: Dataset | str | os.PathLike[str] | None = None,
    false_alarms: float = 0.01,
    discount: float = 1.0,
    horizon: int | None = None,
    training_seed: int | None = None,
    step: int | None = None,
    seed: int = 0,
    settings: EstimateSettings | None = None,
    guard_changes: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> Assessment:
    """Whether a log speaks for running a policy, as it is deployed, without a simulator.

    Args:
        run: a run's directory, a policy or the file of one.
        holdout: episodes that it did not learn from, such as `odaf data split` sets aside.
        keep: comparisons that shall hold in every row, such as "level < 3".
        log: what the policy learned from, for the guard; None takes the run's own data.
        false_alarms: the most sound episodes that may have an alarm; raised where the hold-out has too few for it.
        discount: weight of a reward one step later; 1 sums them plainly.
        horizon: steps of an episode that count; None takes what the log shows.
        training_seed: of a run, whose policy is judged; None the first.
        step: of a run, the checkpoint after so many updates; None the last.
        seed: of everything random.
        settings: sizes of what is fitted to estimate values.
        guard_changes: fields of `odaf.deployment.GuardSettings` by name.
        progress: called with (parts done, parts in all).

    Raises:
        ConfigError: an argument is out of range, or the policy remembers earlier steps.
        DatasetError: policy and log do not fit, or the hold-out has a single episode.
        CheckpointError: there is no run, policy or checkpoint.
        DivergenceError: a fit stopped being finite.
    """
    dataset = holdout if isinstance(holdout, Dataset) else Dataset.load(holdout)
    policy, _ = policy_of(run, training_seed, step)
    conditions = conditions_of(keep, dataset)
    parts, said = 2 + len(conditions), progress or (lambda done, total: None)
    say = _Parts(said, parts)
    valuation = estimate(
        policy, dataset, discount=discount, horizon=horizon, seed=seed, settings=settings, progress=say.part(0)
    )
    kept = tuple(
        _kept(condition, policy, dataset, valuation, seed, settings, say.part(1 + index))
        for index, condition in enumerate(conditions)
    )
    own = actions.own_actions(policy, dataset)
    columns = actions.action_columns(dataset, own)
    guarded, why = _guarded(
        run,
        dataset,
        log,
        false_alarms,
        {"training_seed": training_seed, "step": step, "seed": seed, **(guard_changes or {})},
        say.part(parts - 1),
    )
    report = dataset.check()
    verdict, reasons = verdict_of(valuation[DECIDES], kept, report)
    return Assessment(
        verdict,
        tuple(reasons),
        tuple(reservations(valuation, columns, guarded, report)),
        valuation,
        kept,
        columns,
        guarded,
        why,
        None if guarded is None else _over_time(guarded, dataset),
        report,
        dataset,
        own,
        policy,
        seed,
    )


def aftermath(assessment: Assessment, new: Dataset | str | os.PathLike[str]) -> after.Aftermath:
    """The promise of an assessment beside a log that was written while the policy ran.

    Args:
        assessment: what was promised.
        new: the new log, with the columns of the hold-out.

    Raises:
        DatasetError: it has other columns, or a single episode.
    """
    valuation = assessment.valuation
    conditions = conditions_of([each.text for each in assessment.kept], assessment.holdout)
    return after.happened(
        assessment.policy,
        assessment.guard,
        assessment.holdout,
        new if isinstance(new, Dataset) else Dataset.load(new),
        valuation.horizon,
        valuation.discount,
        assessment.promised,
        list(zip(conditions, assessment.kept, strict=True)),
        valuation.confidence,
        assessment.seed,
    )


class _Parts:
    """Progress of several parts that are alike, as one."""

    def __init__(self, said: Progress, parts: int):
        self._said, self._parts = said, parts

    def part(self, index: int) -> Progress:
        def say(done: int, total: int) -> None:
            self._said(round(1_000 * (index + done / max(total, 1))), 1_000 * self._parts)

        return say


def _kept(
    condition: Condition,
    policy: Policy,
    dataset: Dataset,
    valuation: Valuation,
    seed: int,
    settings: EstimateSettings | None,
    progress: Progress,
) -> Kept:
    episodes, confidence = dataset.num_episodes, valuation.confidence
    broken = int(np.logical_or.reduceat(condition.broken(dataset), dataset.episode_starts).sum())
    logged = share_of(broken, episodes, confidence)
    if broken in (0, episodes):
        lacking = "no logged episode broke it, so that nothing shows what leads there"
        if broken:
            lacking = "every logged episode broke it, so that nothing shows how it is kept"
        reason = f"cannot be told, {lacking}"
        return Kept(condition.text, episodes, broken, logged, None, reason)
    found = estimate(
        policy,
        condition.as_log(dataset),
        method=DECIDES,
        horizon=valuation.horizon,
        seed=seed,
        settings=settings,
        progress=progress,
    )[DECIDES]
    told = found.calibrated or found.value
    if found.verdict == "refused" or told is None:
        return Kept(condition.text, episodes, broken, logged, None, f"cannot be told: {found.reason}")
    value, low, high = (float(np.clip(number, 0.0, 1.0)) for number in (told.value, told.low, told.high))
    return Kept(condition.text, episodes, broken, logged, Interval(value, low, high), "")


def _guarded(
    run: Policy | str | os.PathLike[str],
    dataset: Dataset,
    log: Dataset | str | os.PathLike[str] | None,
    false_alarms: float,
    options: Mapping[str, Any],
    progress: Progress,
) -> tuple[GuardedPolicy | None, str]:
    """The guard at the rate asked for, or at the least that the hold-out can promise; else why there is none."""
    least = 1.0 / (dataset.num_episodes + 1)
    rate = false_alarms if false_alarms >= least else least * (1.0 + 1e-9)
    if rate > 0.5:
        return None, f"{dataset.num_episodes} episodes are too few to promise anything"
    try:
        return make_guard(run, dataset, log=log, false_alarms=rate, progress=progress, **options), ""
    except (ConfigError, DatasetError) as error:
        if not 0.0 < false_alarms < 1.0:
            raise
        return None, str(error)


def _over_time(guard: GuardedPolicy, dataset: Dataset) -> tuple[np.ndarray, np.ndarray]:
    logged, own = (after.ratios(guard, dataset, own=asked) for asked in (False, True))
    worst = int(np.argmax(np.maximum.reduceat(logged, dataset.episode_starts)))
    rows = dataset.episode(worst)
    return logged[rows], own[rows]
