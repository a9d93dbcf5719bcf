"""Why an action may be known or not: the logged rows nearest to it, what was done there and what followed."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from odaf.components.fitting import Batch, of_rows
from odaf.data.dataset import Dataset
from odaf.data.normalisation import scale_actions
from odaf.deployment.guard import GuardedPolicy, judged
from odaf.deployment.nearest import LoggedRows, Neighbour
from odaf.deployment.score import NO_COLUMN, PARTS, GuardScore
from odaf.errors import DatasetError
from odaf.report.plain_tables import table
from odaf.training.policy import Policy


@dataclass(frozen=True)
class Why:
    """What the log knows of an action at an observation.

    Attributes:
        observation: [obs_dim], in the log's units.
        action: [act_dim].
        parts: by name, beside the limit of an alarm: 1 is the limit. Surprise is left out, since no step lies before.
        column: which column the largest part owes most to; empty for none.
        neighbours: the nearest logged rows, the nearest first.
        names: of observations and then actions.
        limit: distance above which there is an alarm.
    """

    observation: np.ndarray
    action: np.ndarray
    parts: dict[str, float]
    column: str
    neighbours: tuple[Neighbour, ...]
    names: tuple[str, ...]
    limit: float

    def __str__(self) -> str:
        largest = max(self.parts, key=self.parts.__getitem__)
        owed = f", mostly '{self.column}'" if self.column else ""
        verdict = "an alarm" if self.parts[largest] > 1.0 else "no alarm"
        said = ", ".join(f"{name} {value:.2f}" for name, value in self.parts.items())
        observed = len(self.observation)
        header = ["row", "episode", "step", "distance", *self.names, "reward", "rest of episode", "then"]
        asked = [*self.observation.tolist(), *self.action.tolist()]
        rows = [["asked", "", "", "", *_numbers(asked), "", "", ""]]
        for each in self.neighbours:
            change = each.next_observation - each.observation
            moved = int(np.argmax(np.abs(change) / np.maximum(np.abs(self._spread()), 1e-12)))
            then = "task ended" if each.ended else f"{self.names[moved]} {change[moved]:+.3g}"
            cells = [*each.observation.tolist(), *each.action.tolist()]
            numbers = [f"{each.distance:.3g}", *_numbers(cells), f"{each.reward:.4g}", f"{each.rest:,.4g}", then]
            rows.append([f"{each.row:,}", f"{each.episode:,}", f"{each.step:,}", *numbers])
        return "\n".join(
            [
                f"{verdict}: {said} of their limits{owed if self.parts[largest] > 1.0 else ''}",
                f"nearest logged rows (a distance above {self.limit:.3g} is an alarm; the first {observed} columns "
                "were seen, the others done):",
                table(header, rows),
            ]
        )

    def _spread(self) -> np.ndarray:
        return np.ptp(np.stack([each.observation for each in self.neighbours] + [self.observation]), axis=0) + 1e-9


class Explainer:
    """The log behind a guard, to be asked about actions.

    Args:
        guarded: the policy and its guard.
        log: what the policy learned from.
    """

    def __init__(self, guarded: GuardedPolicy, log: Dataset):
        self.guarded = guarded
        self._rows = LoggedRows(log, places_of(guarded.score, guarded.policy, log))

    def ask(self, observation: Sequence[float] | np.ndarray, action: np.ndarray | None = None, count: int = 5) -> Why:
        """About an action at an observation (not at readings), in the log's units.

        Args:
            observation: [obs_dim].
            action: [act_dim]; None takes the policy's own.
            count: of the nearest rows.

        Raises:
            DatasetError: a number is missing, or not finite.
        """
        guarded, policy = self.guarded, self.guarded.policy.without_derivation()
        seen = np.asarray(observation, np.float32)
        own = policy(seen) if action is None else np.asarray(action, np.float32)
        if own.shape != (policy.act_dim,) or not np.isfinite(own).all():
            raise DatasetError(f"action: is {own.tolist()}; give {policy.act_dim} finite numbers")
        scaled = np.asarray(scale_actions(own[None], policy.action_low, policy.action_high), np.float32)
        blank = np.full((1, policy.obs_dim), np.nan), np.full((1, policy.act_dim), np.nan)
        found = judged(guarded.score, policy.actor, seen[None], scaled, blank)
        limit = guarded.calibration.threshold
        parts: dict[str, float] = dict(zip(PARTS[:-1], (np.asarray(found.parts)[0, :-1] / limit).tolist(), strict=True))
        column = int(found.column[0])
        point = np.asarray(guarded.score.place(found.state, jnp.asarray(scaled)))[0]
        return Why(
            seen,
            own,
            parts,
            "" if column == NO_COLUMN else guarded.columns[column],
            tuple(self._rows.nearest(point, count)),
            guarded.columns,
            float(guarded.score.levels[PARTS.index("distance")]) * limit,
        )


def places_of(score: GuardScore, policy: Policy, dataset: Dataset) -> np.ndarray:
    """[N, width] whitened coordinates of every logged row and its action."""
    scaled = scale_actions(dataset.actions, policy.action_low, policy.action_high)
    columns = jnp.asarray(dataset.observations), jnp.asarray(scaled, jnp.float32)
    return of_rows(_places, score, columns)


def _places(score: GuardScore, batch: Batch):
    return score.place(score.normalised(batch[0]), batch[1])


def _numbers(values: Sequence[float]) -> list[str]:
    return [f"{value:.4g}" for value in values]
