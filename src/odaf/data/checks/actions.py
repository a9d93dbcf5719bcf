"""Checks of the actions: within their bounds, not glued to them, and continuous at all."""

import numpy as np

from odaf.data.checks.findings import Finding
from odaf.data.checks.stream import Block, Facts, Tally, any_column
from odaf.data.validation import BOUND_TOLERANCE

ON_BOUNDS_SHARE = 0.01
WIDE = 50.0
"""Bounds this many times as wide as what was logged are too wide: a percentage taken for a share is a hundred times."""
MOST_DISCRETE = 32


class Bounds:
    """Actions outside their bounds, or exactly on them."""

    def __init__(self, facts: Facts):
        self._facts = facts
        self._far, self._near, self._on = Tally(), Tally(), Tally()
        self._entries = self._on_entries = 0
        self._low = np.full(facts.act_dim, np.inf)
        self._high = np.full(facts.act_dim, -np.inf)

    def see(self, block: Block) -> None:
        actions = block.columns["actions"]
        # In the precision in which the data set will hold them, so that both agree on what is outside.
        with np.errstate(over="ignore", invalid="ignore"):
            actions = actions.astype(np.float32, copy=False)
        self._low = np.fmin(self._low, np.fmin.reduce(actions, axis=0))
        self._high = np.fmax(self._high, np.fmax.reduce(actions, axis=0))
        low, high = self._facts.low, self._facts.high
        if low is None or high is None:
            return
        self._entries += actions.size
        lowest, highest = actions.min(axis=0), actions.max(axis=0)
        if not ((lowest >= low).all() and (highest <= high).all()):
            with np.errstate(invalid="ignore", over="ignore"):
                excess = np.maximum(low - actions, actions - high)
            far = any_column(excess > BOUND_TOLERANCE * (high - low))
            self._far.add(far, block.first)
            self._near.add(any_column(excess > 0) & ~far, block.first)
        on = (actions == low) | (actions == high)
        count = int(np.count_nonzero(on))
        if count:
            self._on_entries += count
            self._on.add(any_column(on), block.first)

    def findings(self) -> list[Finding]:
        if self._facts.low is None or self._facts.high is None:
            return [
                Finding(
                    "bounds-unknown", "note", "actions", self._facts.act_dim, (),
                    f"no bounds were given; the smallest and largest logged action stand in for them: "
                    f"{self._range(self._low, self._high)}",
                    "pass the actuators' true bounds, or the policy will never leave the logged range",
                )
            ]  # fmt: skip
        found = []
        allowed = self._range(self._facts.low, self._facts.high)
        if self._far.count:
            found.append(
                Finding(
                    "actions-outside-bounds", "error", "actions", self._far.count, tuple(self._far.rows),
                    f"{self._far.count / self._facts.rows:.2%} of the rows leave the bounds: logged "
                    f"{self._range(self._low, self._high)}, allowed {allowed}",
                    "pass the true bounds in the log's own units, or clip the actions at their source if the plant did",
                )
            )  # fmt: skip
        if self._near.count:
            found.append(
                Finding(
                    "actions-rounded-outside", "warning", "actions", self._near.count, tuple(self._near.rows),
                    f"{self._near.count:,} rows miss the bounds {allowed} by rounding, "
                    f"less than {BOUND_TOLERANCE:g} of the range",
                    "nothing to do: they are moved onto the bounds when the data are used, which is recorded",
                )
            )  # fmt: skip
        found += self._too_wide(self._facts.low, self._facts.high)
        if self._on_entries:
            share = self._on_entries / self._entries
            found.append(
                Finding(
                    "actions-on-bounds", "warning" if share >= ON_BOUNDS_SHARE else "note", "actions", self._on.count,
                    tuple(self._on.rows),
                    f"{share:.2%} of all action values lie exactly on a bound, where a squashed Gaussian policy "
                    "has no finite log-density",
                    "fine for learners that only evaluate logged actions; cloning pulls the policy into the corners",
                )
            )  # fmt: skip
        return found

    def _too_wide(self, low: np.ndarray, high: np.ndarray) -> list[Finding]:
        logged, allowed = (np.subtract(*pair, dtype=np.float64) for pair in ((self._high, self._low), (high, low)))
        wide = np.flatnonzero((logged > 0) & (allowed > WIDE * logged))
        if not len(wide):
            return []
        names = ", ".join(self._facts.action_names[column] for column in wide[:8]) + (", ..." if len(wide) > 8 else "")
        return [
            Finding(
                "bounds-too-wide", "warning", "actions", len(wide), (),
                f"the bounds of {names} are up to {float((allowed[wide] / logged[wide]).max()):.3g} times as wide as "
                f"what was logged: {self._range(self._low[wide], self._high[wide])} of "
                f"{self._range(low[wide], high[wide])}",
                "give the actuator's true limits in the log's own unit (--action-bounds; action_bounds in Python): a "
                "policy may answer with anything between them, and the logged actions all look alike",
            )
        ]  # fmt: skip

    def _range(self, low: np.ndarray, high: np.ndarray) -> str:
        if len(low) > 1 and (low == low[0]).all() and (high == high[0]).all():
            low, high = low[:1], high[:1]
        pairs = [f"[{a:.6g}, {b:.6g}]" for a, b in zip(low[:6], high[:6], strict=True)]
        return ", ".join(pairs) + (", ..." if len(low) > 6 else "")


class Discrete:
    """Actions that are numbers of choices, or one-hot choices, instead of amounts."""

    def __init__(self, facts: Facts):
        self._facts = facts
        self._possible = True
        self._one_hot = facts.act_dim > 1
        self._values: set[float] = set()
        self._hot: set[int] = set()

    def see(self, block: Block) -> None:
        if not self._possible:
            return
        actions = block.columns["actions"]
        # A look at few rows settles it for continuous actions, which is the usual case.
        if not self._take(actions[:64]) or not self._take(actions):
            self._possible = False

    def _take(self, actions: np.ndarray) -> bool:
        values = np.unique(actions)
        if len(values) > MOST_DISCRETE or not (values == np.floor(values)).all() or not np.isfinite(values).all():
            return False
        self._values |= set(values.tolist())
        if self._one_hot:
            marked = actions == 1
            self._one_hot = bool(set(values.tolist()) <= {0.0, 1.0} and (marked.sum(axis=1) == 1).all())
            self._hot |= set(np.flatnonzero(marked.any(axis=0)).tolist())
        return len(self._values) <= MOST_DISCRETE

    def findings(self) -> list[Finding]:
        count = len(self._values)
        if not self._possible or count < 2:
            return []
        remedy = "discrete choices are not supported; if this is a continuous actuator, pass its true bounds"
        if self._one_hot and len(self._hot) > 1:
            return [
                Finding(
                    "actions-discrete", "error", "actions", self._facts.rows, (),
                    "every action has a single 1 among zeros: one-hot choices, not amounts", remedy,
                )
            ]  # fmt: skip
        values = sorted(self._values)
        ladder = values == [float(step) for step in range(count)] and self._facts.act_dim == 1
        inside = self._facts.high is not None and values[-1] <= float(self._facts.high.max())
        shown = f"{values[0] + 0.0:g} to {values[-1] + 0.0:g}"  # -0 is 0
        if ladder and not inside:
            return [
                Finding(
                    "actions-discrete", "error", "actions", self._facts.rows, (),
                    f"continuous actions expected, found the whole numbers {shown}", remedy,
                )
            ]  # fmt: skip
        return [
            Finding(
                "actions-few-values", "warning", "actions", self._facts.rows, (),
                f"all actions are whole numbers, {count} different ones from {shown}",
                "a switch or a rounded logger? The policy will be free to choose anything between",
            )
        ]  # fmt: skip
