"""Observations that are computed from readings: formulas, differences, and what was read and done in earlier rows.

The reader of tables applies them to a whole log and writes them down as recipes, in JSON types, under
`provenance["derived"]`. `Derivation.from_provenance` makes of the recipes what a policy needs at its place of
work: from the readings of one step after another come the very observations that the log would have held.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from odaf.data import expressions
from odaf.data.expressions import Expression
from odaf.errors import DatasetError


@dataclass(frozen=True)
class State:
    """What a derivation remembers of the steps before; made by `Derivation.begin`, new for every episode.

    Attributes:
        observations: the undelayed observations of the steps before, the latest first, as float32.
        actions: what was done in these steps.
        awaits_action: whether the action of the latest step has yet to be told.
    """

    observations: tuple[np.ndarray, ...] = ()
    actions: tuple[np.ndarray, ...] = ()
    awaits_action: bool = False


@dataclass(frozen=True)
class Derivation:
    """How observations come from readings.

    An observation holds, in this order: readings and formulas as they were listed; with `differences`, the change of
    each of these since the row before; and for k = 1 to `lags` each of these (not the differences) of k rows before,
    and each action of k rows before.

    Attributes:
        parts: a name each; with a formula, it is computed, without one it is the reading of that name.
        differences: whether changes since the row before are added.
        lags: how many earlier rows are added.
        actions: names of the actions; those of earlier rows are part of the observation where `lags` is not 0.
    """

    parts: tuple[tuple[str, Expression | None], ...]
    differences: bool = False
    lags: int = 0
    actions: tuple[str, ...] = ()

    @classmethod
    def from_provenance(cls, provenance: Mapping[str, Any]) -> "Derivation | None":
        """The derivation that a data set's provenance records; None where observations are the readings themselves.

        Raises:
            DatasetError: it records recipes that this version does not know.
        """
        recipes = [recipe for recipe in provenance.get("derived", ()) if recipe.get("recipe") != "reward"]
        if all(recipe.get("recipe") == "readings" for recipe in recipes):
            return None
        parts: list[tuple[str, Expression | None]] = []
        found = cls(())
        for recipe in recipes:
            kind = recipe.get("recipe")
            if kind == "readings":
                parts += [(str(name), None) for name in recipe["columns"]]
            elif kind == "expression":
                parts.append((str(recipe["name"]), expressions.parse(str(recipe["expression"]))))
            elif kind == "differences":
                found = replace(found, differences=True)
            elif kind == "lags":
                found = replace(found, lags=int(recipe["rows"]), actions=tuple(recipe["actions"]))
            else:
                raise DatasetError(
                    f"provenance: derived: recipe {kind!r} is unknown to this version; use the version that wrote it"
                )
        return replace(found, parts=tuple(parts))

    def recipes(self) -> list[dict[str, Any]]:
        """What `from_provenance` reads, in JSON types."""
        found: list[dict[str, Any]] = []
        for name, formula in self.parts:
            if formula is not None:
                found.append({"recipe": "expression", "name": name, "expression": formula.text})
            elif found and found[-1]["recipe"] == "readings":
                found[-1]["columns"].append(name)
            else:
                found.append({"recipe": "readings", "columns": [name]})
        if self.differences:
            found.append({"recipe": "differences"})
        if self.lags:
            found.append({"recipe": "lags", "rows": self.lags, "actions": list(self.actions)})
        return found

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the observations, in order."""
        own = [name for name, _ in self.parts]
        changes = [f"{name}_change" for name in own] if self.differences else []
        lags = range(1, self.lags + 1)
        return (*own, *changes, *(f"{name}_lag{lag}" for lag in lags for name in (*own, *self.actions)))

    @cached_property
    def readings(self) -> tuple[str, ...]:
        """Names of the columns that each step has to give."""
        return read_by(self.parts)

    @property
    def derives(self) -> bool:
        """Whether observations are more than the readings themselves."""
        return bool(self.lags or self.differences or any(formula is not None for _, formula in self.parts))

    @property
    def history(self) -> int:
        """How many rows must lie before one of an episode for its observation to be known."""
        return max(self.lags, int(self.differences))

    def begin(self) -> State:
        """The state before the first step of an episode."""
        return State()

    def step(self, readings: Mapping[str, Any], state: State) -> tuple[np.ndarray | None, State]:
        """The observation of one step, and what is to be remembered for the next.

        Args:
            readings: a number by name, at least `self.readings`, in the units of the log.
            state: of the step before.

        Returns:
            [observations] float32, or None in the first `history` steps of an episode, for which the log has no
            observation either: somebody else has to act there. Where `lags` is not 0, tell the next step with `acted`
            what was done in this one.

        Raises:
            DatasetError: a reading is missing or not finite, or nothing was said of what was done in the step before.
        """
        if state.awaits_action:
            raise DatasetError(
                "derivation: the action of the step before is part of this observation; "
                "tell it with acted(action, state) between two steps"
            )
        own = self._undelayed(readings)
        known = len(state.observations) >= self.history
        observation = self._joined(own, state) if known else None
        kept = (own, *state.observations)[: self.history]
        return observation, replace(state, observations=kept, awaits_action=self.lags > 0)

    def acted(self, action: Mapping[str, Any] | Sequence[float] | np.ndarray, state: State) -> State:
        """The state with what was done in the step that `step` saw last: by name, or in the order of `actions`.

        Raises:
            DatasetError: an action is missing, unknown or not finite.
        """
        if not self.lags:
            return state
        if isinstance(action, Mapping):
            missing = [name for name in self.actions if name not in action]
            if missing:
                raise DatasetError(f"derivation: action '{missing[0]}' is missing; give {', '.join(self.actions)}")
            action = [action[name] for name in self.actions]
        values = np.asarray(action, np.float32).reshape(-1)
        if values.shape != (len(self.actions),) or not np.isfinite(values).all():
            raise DatasetError(
                f"derivation: got {values.tolist()} as the action; give a number for each of {', '.join(self.actions)}"
            )
        return replace(state, actions=(values, *state.actions)[: self.lags], awaits_action=False)

    def of_log(self, own: np.ndarray, actions: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Observations of a whole log.

        Args:
            own: [rows, len(parts)] float32, the undelayed observations.
            actions: [rows, act_dim] float32.
            first: [rows] bool, where episodes begin.

        Returns:
            [rows, len(names)] float32, and [rows] bool: whether so many rows of its episode lie before the row that
            its observation is known.
        """
        rows = len(own)
        number = np.arange(rows) - np.maximum.accumulate(np.where(first, np.arange(rows), 0))
        parts = [own]
        if self.differences:
            parts.append(own - _delayed(own, 1))
        for lag in range(1, self.lags + 1):
            parts += [_delayed(own, lag), _delayed(actions, lag)]
        return np.concatenate(parts, axis=1), number >= self.history

    def _undelayed(self, readings: Mapping[str, Any]) -> np.ndarray:
        missing = [name for name in self.readings if name not in readings]
        if missing:
            raise DatasetError(f"derivation: reading '{missing[0]}' is missing; give {', '.join(self.readings)}")
        values: dict[str, np.ndarray] = {}
        for name in self.readings:
            try:
                values[name] = np.asarray(readings[name], np.float64).reshape(1)
            except (TypeError, ValueError) as error:
                raise DatasetError(
                    f"derivation: reading '{name}' is {readings[name]!r:.40}, which is no single number"
                ) from error
            if not np.isfinite(values[name]).all():
                raise DatasetError(
                    f"derivation: reading '{name}' is not a finite number; a policy has no answer to a missing value, "
                    "so replace it before the call"
                )
        own = computed(self.parts, values)
        if not np.isfinite(own).all():
            name = self.parts[int(np.flatnonzero(~np.isfinite(own[0]))[0])][0]
            raise DatasetError(f"derivation: '{name}' is not finite for the readings given; check them")
        return own[0]

    def _joined(self, own: np.ndarray, state: State) -> np.ndarray:
        before = state.observations
        parts = [own, *([own - before[0]] if self.differences else [])]
        for lag in range(self.lags):
            parts += [before[lag], state.actions[lag]]
        return np.concatenate(parts)


def read_by(parts: Sequence[tuple[str, Expression | None]]) -> tuple[str, ...]:
    """Names of the columns that readings and formulas take, each once; formulas may take those before them."""
    found: dict[str, None] = {}
    formulas: set[str] = set()
    for name, formula in parts:
        found |= dict.fromkeys((name,) if formula is None else (c for c in formula.columns if c not in formulas))
        formulas |= set() if formula is None else {name}
    return tuple(found)


def computed(parts: Sequence[tuple[str, Expression | None]], readings: Mapping[str, np.ndarray]) -> np.ndarray:
    """[rows, len(parts)] float32 from columns of readings [rows] in double precision.

    A formula may use those before it by their names, which no column of the table has.
    """
    results: list[np.ndarray] = []
    known = dict(readings)
    for name, formula in parts:
        values = readings[name] if formula is None else formula(known)
        if formula is not None:
            known[name] = values
        with np.errstate(over="ignore"):
            results.append(values.astype(np.float32))
    return np.stack(results, axis=1)


def _delayed(values: np.ndarray, lag: int) -> np.ndarray:
    """Each row's values of `lag` rows before; zero where there are none."""
    result = np.zeros_like(values)
    result[lag:] = values[: max(len(values) - lag, 0)]
    return result
