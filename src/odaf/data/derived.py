"""Observations that are computed from readings: formulas, differences, and what was read and done in earlier rows.

The reader of tables applies them to a whole log and writes them down as recipes, in JSON types, under
`provenance["derived"]`. `Derivation.from_provenance` makes of the recipes what a policy needs at its place of
work: from the readings of one step after another come the very observations that the log would have held.
`odaf.Policy` does this by itself.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from odaf.data import expressions
from odaf.data.expressions import Expression
from odaf.errors import DatasetError

_MOST_LAGS = 100_000


class Memory(NamedTuple):
    """What a derivation remembers of the steps before, for episodes side by side; NaN where nothing is known yet.

    Attributes:
        observations: [rows, history, len(parts)] float32, the undelayed observations, the latest first.
        actions: [rows, lags, len(actions)] float32, what was done in these steps.
    """

    observations: np.ndarray
    actions: np.ndarray


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
        try:
            return cls.from_recipes(recipes)
        except DatasetError as error:
            raise DatasetError(f"provenance: derived: {error}") from error

    @classmethod
    def from_recipes(cls, recipes: Iterable[Any]) -> "Derivation":
        """Inverse of `recipes`; runs no code, whatever stands in them.

        Raises:
            DatasetError: a recipe is none, or one that this version does not know.
        """
        parts: list[tuple[str, Expression | None]] = []
        found = cls(())
        for recipe in recipes:
            kind = recipe.get("recipe") if isinstance(recipe, Mapping) else None
            try:
                if kind == "readings":
                    parts += [(_text(name), None) for name in recipe["columns"]]
                elif kind == "expression":
                    parts.append((_text(recipe["name"]), expressions.parse(_text(recipe["expression"]))))
                elif kind == "differences":
                    found = replace(found, differences=True)
                elif kind == "lags" and 0 < int(recipe["rows"]) <= _MOST_LAGS:
                    found = replace(found, lags=int(recipe["rows"]), actions=tuple(map(_text, recipe["actions"])))
                else:
                    raise DatasetError(f"recipe {kind!r} is unknown to this version; use the version that wrote it")
            except (KeyError, TypeError, ValueError) as error:
                raise DatasetError(f"recipe {kind!r} is damaged ({error!r}); use the file as it was written") from error
        if not parts:
            raise DatasetError("recipes name no reading and no formula; use the file as it was written")
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

    def begin(self, rows: int = 1) -> Memory:
        """What is remembered before the first step of `rows` episodes that go side by side: nothing."""
        widths = (self.history, len(self.parts)), (self.lags, len(self.actions))
        return Memory(*(np.full((rows, *width), np.nan, np.float32) for width in widths))

    def step(self, readings: np.ndarray, memory: Memory) -> tuple[np.ndarray, Memory]:
        """The observations of one step, and what is to be remembered for the next.

        Args:
            readings: [rows, len(self.readings)] float64, in the units of the log.
            memory: of the step before.

        Returns:
            [rows, len(self.names)] float32, with NaN in rows of which fewer than `history` steps are known: for these
            the log has no observation either, and somebody else has to act. Where `lags` is not 0, tell the next step
            with `acted` what was done in this one.

        Raises:
            DatasetError: a reading or what is computed of it is not finite, or nothing was said of what was done in the
                step before.
        """
        if self.lags and (np.isnan(memory.actions[:, 0]).any(axis=1) & ~np.isnan(memory.observations[:, 0, 0])).any():
            raise DatasetError(
                "derivation: the action of the step before is part of this observation, and that step has none; tell "
                "what was done there with carry = policy.acted(carry, action) between the two steps"
            )
        own = self._undelayed(readings)
        before = memory.observations
        parts = [own, *([own - before[:, 0]] if self.differences else [])]
        for lag in range(self.lags):
            parts += [before[:, lag], memory.actions[:, lag]]
        later = np.concatenate([own[:, None], before], axis=1)[:, : self.history]
        actions = np.concatenate([np.full_like(memory.actions[:, :1], np.nan), memory.actions[:, :-1]], axis=1)
        return np.concatenate(parts, axis=1), Memory(later, actions)

    def acted(self, actions: np.ndarray, memory: Memory) -> Memory:
        """What is remembered once it is known what was done in the step that `step` saw last.

        Args:
            actions: [rows, len(self.actions)], NaN where it is still not known.
            memory: of `step`.
        """
        if not self.lags:
            return memory
        told = np.asarray(actions, np.float32)[:, None]
        return memory._replace(actions=np.concatenate([told, memory.actions[:, 1:]], axis=1))

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

    def _undelayed(self, readings: np.ndarray) -> np.ndarray:
        """[rows, len(parts)] float32."""
        if not np.isfinite(readings).all():
            row, column = np.argwhere(~np.isfinite(readings))[0].tolist()
            where = _in_row(row, readings)
            raise DatasetError(
                f"derivation: reading '{self.readings[column]}' is not a finite number{where}; a policy has no answer "
                "to a missing value, so replace it before the call"
            )
        own = computed(self.parts, dict(zip(self.readings, readings.T, strict=True)))
        if not np.isfinite(own).all():
            row, part = np.argwhere(~np.isfinite(own))[0].tolist()
            name, formula = self.parts[part]
            given = ", ".join(
                f"{column} {value:.6g}" for column, value in zip(self.readings, readings[row].tolist(), strict=True)
            )
            what = name if formula is None else f"{name} = {formula.text}"
            raise DatasetError(
                f"derivation: '{what}' has no finite value for these readings{_in_row(row, readings)} ({given[:200]}); "
                "correct them, or leave the action of this step to somebody else"
            )
        return own


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


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{value!r} is no text")
    return value


def _in_row(row: int, readings: np.ndarray) -> str:
    return f" in row {row}" if len(readings) > 1 else ""


def _delayed(values: np.ndarray, lag: int) -> np.ndarray:
    """Each row's values of `lag` rows before; zero where there are none."""
    result = np.zeros_like(values)
    result[lag:] = values[: max(len(values) - lag, 0)]
    return result
