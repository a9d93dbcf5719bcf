"""Checks of single numbers and of columns: finite, in range, not constant, of comparable scale."""

import numpy as np

from odaf.data.checks.findings import Finding
from odaf.data.checks.moments import Moments
from odaf.data.checks.stream import FLAGS, Block, Facts, Tally, any_column
from odaf.data.rounding import few_steps_in_single

_LARGEST = float(np.finfo(np.float32).max)
SCALE_RATIO = 1e4
SMALL = 2_560  # ten batches of the usual 256


class Finite:
    """NaN, infinity, and numbers that single precision cannot hold."""

    def __init__(self, facts: Facts):
        self._fields = [
            name
            for name in ("observations", "actions", "rewards", "next_observations", "time")
            if name in facts.fields and facts.log.columns[name].dtype.kind == "f"
        ]
        self._bad = {name: Tally() for name in self._fields}
        self._values = dict.fromkeys(self._fields, 0)
        self._columns: dict[str, set[int]] = {name: set() for name in self._fields}
        self._huge = {name: Tally() for name in self._fields}

    def see(self, block: Block) -> None:
        for name in self._fields:
            values = block.columns[name]
            finite = np.isfinite(values)
            if not finite.all():
                bad = ~finite
                self._bad[name].add(any_column(bad), block.first)
                self._values[name] += int(bad.sum())
                if bad.ndim == 2:
                    self._columns[name] |= set(np.flatnonzero(bad.any(axis=0)).tolist())
            if values.dtype.itemsize > 4 and name != "time":
                with np.errstate(invalid="ignore"):
                    self._huge[name].add(any_column(finite & (np.abs(values) > _LARGEST)), block.first)

    def findings(self) -> list[Finding]:
        found = []
        for name in self._fields:
            tally, huge = self._bad[name], self._huge[name]
            if tally.count:
                columns = f" (columns {sorted(self._columns[name])})" if self._columns[name] else ""
                found.append(
                    Finding(
                        "not-finite", "error", name, tally.count, tuple(tally.rows),
                        f"{self._values[name]:,} values are NaN or infinite, in {tally.count:,} rows{columns}",
                        "repair these rows at their source, or leave out the whole episodes they belong to",
                    )
                )  # fmt: skip
            if huge.count:
                found.append(
                    Finding(
                        "too-large", "error", name, huge.count, tuple(huge.rows),
                        f"{huge.count:,} rows hold numbers beyond single precision (3.4e38)", "change the unit",
                    )
                )  # fmt: skip
        return found


class FlagValues:
    """End flags that hold something else than true and false."""

    def __init__(self, facts: Facts):
        self._fields = [n for n in FLAGS if n in facts.fields and facts.log.columns[n].dtype.kind != "b"]
        self._odd = {name: Tally() for name in self._fields}
        self._example: dict[str, object] = {}

    def see(self, block: Block) -> None:
        for name in self._fields:
            values = block.raw[name].reshape(len(block))
            odd = (values != 0) & (values != 1)
            if odd.any():
                self._example.setdefault(name, values[odd][0].item())
                self._odd[name].add(odd, block.first)

    def findings(self) -> list[Finding]:
        return [
            Finding(
                "flag-values", "error", name, tally.count, tuple(tally.rows),
                f"{tally.count:,} rows hold neither 0 nor 1, for instance {self._example[name]}",
                "derive a flag that is true only where the episode ends",
            )
            for name, tally in self._odd.items()
            if tally.count
        ]  # fmt: skip


class Columns:
    """Mean, spread and range of each column; what they say about constants, scales and rewards."""

    def __init__(self, facts: Facts):
        self._facts = facts
        self.moments = {name: Moments() for name in ("observations", "actions", "rewards") if name in facts.fields}

    def see(self, block: Block) -> None:
        for name, moments in self.moments.items():
            values = block.columns[name]
            moments.add(values if values.ndim == 2 else values[:, None])

    def findings(self) -> list[Finding]:
        found = []
        for name in ("observations", "actions"):
            if name in self.moments:
                found += self._constant(name, self.moments[name])
        if "observations" in self.moments:
            found += self._scales(self.moments["observations"])
        if "rewards" in self.moments:
            found += self._reward(self.moments["rewards"])
        if self._facts.rows < SMALL:
            found.append(
                Finding(
                    "too-few", "warning", "", self._facts.rows, (),
                    f"there are {self._facts.rows:,} rows, less than ten batches of 256",
                    "expect overfitting: record more, or use a small network, a small batch and few updates",
                )
            )  # fmt: skip
        return found

    def _constant(self, name: str, moments: Moments) -> list[Finding]:
        constant = np.flatnonzero((moments.low == moments.high) & (moments.count > 0))
        if not len(constant):
            return []
        names = self._names(name, constant)
        if name == "observations":
            remedy = "it does no harm (the scale is floored), but says nothing: leave it out if it never will change"
        elif self._facts.low is None:
            return [
                Finding(
                    "constant-dimension", "error", name, len(constant), (),
                    f"{names} never change, so their range is unknown",
                    "pass the actions' true bounds, or leave the column out",
                )
            ]  # fmt: skip
        else:
            remedy = "nothing can be learned about this actuator: leave it out, or log episodes where it moves"
        return [Finding("constant-dimension", "warning", name, len(constant), (), f"{names} never change", remedy)]

    def _scales(self, moments: Moments) -> list[Finding]:
        found = []
        moving = np.flatnonzero(moments.std > 0)
        if len(moving) and moments.std[moving].max() > SCALE_RATIO * moments.std[moving].min():
            widest = moving[np.argmax(moments.std[moving])]
            narrowest = moving[np.argmin(moments.std[moving])]
            found.append(
                Finding(
                    "scales-differ", "note", "observations", len(moving), (),
                    f"spread from {moments.std[narrowest]:.3g} in {self._names('observations', [narrowest])} "
                    f"to {moments.std[widest]:.3g} in {self._names('observations', [widest])}",
                    "nothing to do while observations are normalised, as they are from the start",
                )
            )  # fmt: skip
        with np.errstate(divide="ignore", invalid="ignore"):
            far = (moments.std > 0) & (np.abs(moments.mean) > 1e5 * moments.std)
        lost = far & self._lost_in_single(moments)
        if lost.any():
            columns = np.flatnonzero(lost)
            found.append(
                Finding(
                    "far-from-zero", "error", "observations", len(columns), (),
                    f"{self._names('observations', columns)} vary by less than single precision can hold at their size",
                    "subtract a constant at the source, or keep a clock or counter out of the observations",
                )
            )  # fmt: skip
        far = np.flatnonzero(far & ~lost)
        if len(far):
            found.append(
                Finding(
                    "far-from-zero", "warning", "observations", len(far), (),
                    f"{self._names('observations', far)} vary by less than 1e-5 of their size, "
                    "so single precision rounds the difference away",
                    "subtract a constant at the source; a clock or counter should start anew in each episode",
                )
            )  # fmt: skip
        return found

    def _lost_in_single(self, moments: Moments) -> np.ndarray:
        """[columns] bool: those of double precision that `Dataset.from_arrays` refuses as indistinguishable."""
        if np.dtype(self._facts.log.columns["observations"].dtype).itemsize < 8:
            return np.zeros(moments.std.shape, bool)
        return few_steps_in_single(moments.low, moments.high)

    def _reward(self, moments: Moments) -> list[Finding]:
        if moments.count == 0 or moments.low[0] != moments.high[0]:
            return []
        value = float(moments.low[0])
        remedy = "compute the reward from the log and store it; with nothing to tell rows apart nothing is learned"
        if value != 0:
            remedy = "only the length of episodes counts then; if that is not the task, compute a reward from the log"
        return [
            Finding(
                "reward-constant", "warning", "rewards", self._facts.rows, (), f"every reward is {value:g}", remedy
            )
        ]  # fmt: skip

    def _names(self, field: str, columns: np.ndarray | list) -> str:
        given = self._facts.log.observation_names if field == "observations" else self._facts.log.action_names
        shown = [given[i] if given is not None and i < len(given) else str(int(i)) for i in columns[:8]]
        return f"{'column' if len(columns) == 1 else 'columns'} {', '.join(shown)}" + (
            ", ..." if len(columns) > 8 else ""
        )
