"""How the answers of a log become one verdict.

- **refused**: the log's checks found an error, or it cannot tell what the policy is worth.
- **worse**: the policy surely earns less than whoever wrote the log, or surely breaks a condition more often.
- **better**: it surely earns more, and breaks no condition surely more often.
- **not decided**: everything else.

"Surely" is an interval that leaves the other one out. What does not change the verdict but should be looked at before
anything runs stands beside it as a reservation.
"""

from collections.abc import Sequence

from odaf.assessment.actions import ActionColumn
from odaf.assessment.conditions import Kept
from odaf.data.checks.findings import Report
from odaf.deployment.guard import GuardedPolicy
from odaf.estimation import Valuation, ValueEstimate
from odaf.estimation.valuation import Verdict

MANY_ALARMS = 0.5  # share of episodes in which the policy's own actions have an alarm
FAR_JUMPS = 0.01  # share of changes above the largest logged one
OUTSIDE = 0.01  # share of actions beyond the logged ones


def verdict_of(found: ValueEstimate, kept: Sequence[Kept], report: Report) -> tuple[Verdict, list[str]]:
    """The verdict and the reasons for it; see the head of this file."""
    errors = report.of("error")
    if errors:
        return "refused", [f"the log's checks found errors, such as {errors[0].message}"]
    if found.verdict == "refused":
        return "refused", [f"the log cannot tell what the policy is worth: {found.reason}"]
    worse = [f"it breaks '{each.text}' surely more often than whoever wrote the log" for each in kept if each.worse]
    if found.verdict == "worse":
        worse.insert(0, "it surely earns less than whoever wrote the log")
    if worse:
        return "worse", worse
    if found.verdict == "better":
        return "better", ["it surely earns more than whoever wrote the log"]
    return "not decided", ["the interval of the difference from what was logged holds zero"]


def reservations(
    valuation: Valuation,
    columns: Sequence[ActionColumn],
    guard: GuardedPolicy | None,
    report: Report,
) -> list[str]:
    """What does not change the verdict, but should be looked at before anything runs."""
    said = []
    for column in columns:
        if column.outside > OUTSIDE:
            said.append(f"{column.outside:.0%} of the actions {column.name} lie beyond every logged one")
        if column.jumps > FAR_JUMPS:
            said.append(
                f"{column.jumps:.0%} of the changes of {column.name} are larger than any logged one; "
                f"`odaf export --max-change {column.name}=...` limits them"
            )
    if guard is not None and guard.facts["policy_alarms"] > MANY_ALARMS * guard.calibration.episodes:
        said.append(
            f"the guard would have an alarm in {guard.facts['policy_alarms']:,} of {guard.calibration.episodes:,} "
            "episodes if the policy acted: it leads away from what the log knows"
        )
    warnings = report.of("warning")
    if warnings:
        said.append(f"the log's checks have {len(warnings)} warnings, such as: {warnings[0].message}")
    return said + list(valuation.notes)
