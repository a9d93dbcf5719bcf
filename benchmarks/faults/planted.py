"""Faults, planted at stated sizes in sound logs, and which finding should name each."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.faults.simulation import Rows, Tampering
from benchmarks.faults.sound import KINDS, Kind
from odaf.data import Dataset
from odaf.data.checks.signs.neighbours import nearest
from odaf.data.log import Log

LARGEST = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class Fault:
    """One fault.

    Attributes:
        checks: findings that name it; one of them is enough.
        sizes: by size, how to plant it: (kind, seed) -> log, or None where the kind cannot have it.
        not_in: kinds that cannot have it or cannot show it, each with the reason.
    """

    checks: tuple[str, ...]
    sizes: Mapping[str, Callable[[Kind, int], Log | None]]
    not_in: dict[str, str]


def as_log(rows: Rows, successors: bool = False) -> Log:
    """What a reader would return.

    Args:
        successors: whether next observations are logged.
    """
    columns = {
        "observations": rows.observations.astype(np.float32),
        "actions": rows.actions.astype(np.float32),
        "rewards": rows.rewards.astype(np.float32),
        "terminated": rows.terminated,
        "truncated": rows.truncated,
    }
    if rows.keep_ids:
        columns["episode"] = rows.episode
    if successors and rows.next_observations is not None:
        columns["next_observations"] = rows.next_observations.astype(np.float32)
    return Log(columns, "log", "csv", action_bounds=rows.bounds)


def in_memory(log: Log) -> Log:
    """The same by way of a data set, which completes successors and drops rows without one."""
    columns: dict[str, Any] = dict(log.columns)
    return Dataset.from_arrays(**columns, action_bounds=log.action_bounds).to_log()


# ---- ends ----------------------------------------------------------------------------------------------------------


def no_ends(length: int) -> Callable[[Kind, int], Log]:
    """All episodes, of this length, as one."""

    def plant(kind: Kind, seed: int) -> Log:
        rows = kind.make(seed, length=length)
        none = np.zeros(len(rows.rewards), bool)
        return as_log(replace(rows, episode=np.zeros(len(none), int), terminated=none, truncated=none))

    return plant


def lost_ends(share: float) -> Callable[[Kind, int], Log]:
    """This share of the episodes lost its end."""

    def plant(kind: Kind, seed: int) -> Log:
        rows = kind.make(seed)
        rng = np.random.default_rng([seed, 11])
        lost = np.append(False, rng.random(len(rows.starts) - 1) < share)
        lost[rng.integers(1, len(lost))] = True
        episode = np.cumsum(~lost)[rows.episode]
        last = np.append(episode[1:] != episode[:-1], True)
        return as_log(
            replace(rows, episode=episode, terminated=rows.terminated & last, truncated=rows.truncated & last)
        )

    return plant


def late_flags(kind: Kind, seed: int) -> Log:
    """Each end flag one row late, no ids."""
    rows = kind.make(seed)
    terminated, truncated = (np.append(False, flag[:-1]) for flag in (rows.terminated, rows.truncated))
    truncated[-1] = not terminated[-1]
    return as_log(replace(rows, terminated=terminated, truncated=truncated, keep_ids=False))


def late_against_successors(kind: Kind, seed: int) -> Log:
    """Each end flag one row late, beside next observations that are right."""
    log = late_flags(kind, seed)
    following = kind.make(seed).next_observations
    assert following is not None
    return replace(log, columns={**log.columns, "next_observations": following.astype(np.float32)})


def rolled(kind: Kind, seed: int) -> Log:
    """Next observations by numpy.roll."""
    log = as_log(kind.make(seed))
    following = np.roll(np.asarray(log.columns["observations"]), -1, axis=0)
    return replace(log, columns={**log.columns, "next_observations": following})


def staying(rows_on: int) -> Callable[[Kind, int], Log]:
    """The plant is logged on after the end of each episode, and the flag stays on for as many rows."""

    def plant(kind: Kind, seed: int) -> Log:
        rows = kind.make(seed)
        starts, lengths = rows.starts, rows.lengths
        on = np.zeros(len(rows.rewards), bool)
        for start, length in zip(starts, lengths, strict=True):
            on[start + max(1, length - rows_on) : start + length] = True
        return as_log(replace(rows, terminated=on, truncated=np.zeros(len(on), bool), keep_ids=False), successors=True)

    return plant


# ---- numbers -------------------------------------------------------------------------------------------------------


def wide(factor: float) -> Callable[[Kind, int], Log]:
    """Bounds as many times as wide."""

    def plant(kind: Kind, seed: int) -> Log:
        log = as_log(kind.make(seed))
        low, high = kind.make(seed).bounds
        middle, half = (low + high) / 2, (high - low) / 2
        bounds = (-LARGEST, LARGEST) if factor == np.inf else (middle - factor * half, middle + factor * half)
        return replace(log, action_bounds=bounds)

    return plant


def reward_times(factor: float) -> Callable[[Kind, int], Log]:
    """Rewards in another unit."""

    def plant(kind: Kind, seed: int) -> Log:
        rows = kind.make(seed)
        return as_log(replace(rows, rewards=rows.rewards * factor))

    return plant


def fragment(share: float) -> Callable[[Kind, int], Log | None]:
    """Costs instead of rewards, and one episode cut by the recording after this share of it."""

    def plant(kind: Kind, seed: int) -> Log | None:
        rows = kind.make(seed)
        if len(rows.starts) < 5:
            return None
        chosen = int(np.random.default_rng([seed, 12]).integers(len(rows.starts)))
        start, length = rows.starts[chosen], rows.lengths[chosen]
        keep = np.ones(len(rows.rewards), bool)
        keep[start + max(1, int(share * np.median(rows.lengths))) : start + length] = False
        costs = rows.rewards - rows.rewards.max() - rows.rewards.std()
        cut = rows.truncated.copy()
        cut[np.flatnonzero(keep[start : start + length])[-1] + start] = True
        names = ("observations", "actions", "episode")
        columns = {name: getattr(rows, name)[keep] for name in names}
        own = rows.terminated & ~cut
        return as_log(
            Rows(**columns, rewards=costs[keep], terminated=own[keep], truncated=cut[keep], bounds=rows.bounds)
        )

    return plant


def a_few_good(share: float, spreads: float) -> Callable[[Kind, int], Log | None]:
    """This share of the episodes, at least three, earned more: by these spreads of returns and of returns per step."""

    def plant(kind: Kind, seed: int) -> Log | None:
        rows = kind.make(seed)
        episodes = len(rows.starts)
        if episodes < 20:
            return None
        count = max(3, round(share * episodes))
        chosen = np.random.default_rng([seed, 21]).choice(episodes, count, replace=False)
        returns = np.add.reduceat(rows.rewards.astype(np.float64), rows.starts)
        more = np.zeros(episodes)
        more[chosen] = spreads * np.maximum(returns.std() / rows.lengths, (returns / rows.lengths).std())[chosen]
        return as_log(replace(rows, rewards=rows.rewards + np.repeat(more, rows.lengths)))

    return plant


def told_by_the_row(rows: Rows) -> float:
    """Share of the actions' variance that ten near rows of other episodes tell: turned around, noise stays noise."""
    chosen = np.unique(np.linspace(0, len(rows.rewards) - 1, 3_000).astype(int))
    moving = rows.observations.std(axis=0) > 0
    points = (rows.observations[chosen][:, moving] / rows.observations.std(axis=0)[moving]).astype(np.float32)
    actions = rows.actions[chosen]
    near, _ = nearest(points, rows.episode[chosen], np.arange(len(chosen)), np.arange(len(chosen)), 10)
    left = actions - actions[near].mean(axis=1)
    return float(1 - np.square(left).mean() / 1.1 / actions.var(axis=0).mean())


# ---- what a log cannot teach ---------------------------------------------------------------------------------------


def holds_action(lead: int, unit: float, noise: float = 0.0) -> Callable[[Kind, int], Log]:
    """One more column: the first action of the row itself (lead 0) or of the next row (1), in this unit.

    Args:
        noise: of a measured position, as a share of the action's spread.
    """

    def plant(kind: Kind, seed: int) -> Log:
        rows = kind.make(seed)
        rng = np.random.default_rng([seed, 13])
        column = rows.actions[:, 0].copy()
        if lead:
            last = rows.starts + rows.lengths - 1
            column = np.append(column[1:], column[-1])
            column[last] = rows.actions[last, 0]
        column = unit * (column + noise * column.std() * rng.normal(size=len(column)))
        place = rng.integers(rows.observations.shape[1] + 1)
        return as_log(replace(rows, observations=np.insert(rows.observations, place, column, axis=1)))

    return plant


def reward_from(field: str, form: str) -> Callable[[Kind, int], Log | None]:
    """A reward that one column says: in a straight line, or by a parabola; of the row's own or the next observation."""

    def plant(kind: Kind, seed: int) -> Log | None:
        rows = kind.make(seed)
        source = getattr(rows, field)
        rng = np.random.default_rng([seed, 14])
        moving = np.flatnonzero(source.std(axis=0) > 0)
        column = source[:, rng.choice(moving)]
        scaled = (column - column.mean()) / column.std()
        return as_log(replace(rows, rewards=scaled if form == "line" else -((scaled - 0.5) ** 2)))

    return plant


def delayed(rows_late: int) -> Callable[[Kind, int], Log]:
    """Actions act as many rows late."""
    return lambda kind, seed: as_log(kind.make(seed, Tampering(delay=rows_late)))


def idle(every: bool) -> Callable[[Kind, int], Log | None]:
    """Recorded actions change nothing: all of them, or the last of several."""

    def plant(kind: Kind, seed: int) -> Log | None:
        count = kind.make(seed).actions.shape[1]
        if count == 1 and not every:
            return None
        return as_log(kind.make(seed, Tampering(idle=tuple(range(count)) if every else (count - 1,))))

    return plant


def otherwise(share: float, size: float, form: str) -> Callable[[Kind, int], Log | None]:
    """This share of the episodes has other actions than belong to its states.

    Args:
        form: "turned" around the middle of their range; "shifted" by `size` spreads; "opposite": up by so much on one
            side of a column and down on the other, where the rest do the reverse.
    """

    def plant(kind: Kind, seed: int) -> Log | None:
        rows = kind.make(seed)
        if len(rows.starts) < 10:
            return None
        chosen = np.random.default_rng([seed, 15]).random(len(rows.starts)) < share
        chosen[:3] = True
        second = chosen[rows.episode][:, None]
        spread = size * rows.actions.std(axis=0)
        low, high = (np.asarray(edge, float) for edge in rows.bounds)
        if form == "turned":
            if told_by_the_row(rows) < 0.5:
                return None
            return as_log(replace(rows, actions=np.where(second, low + high - rows.actions, rows.actions)))
        column = rows.observations[:, np.argmax([len(np.unique(values)) for values in rows.observations.T])]
        side = np.sign(column - np.median(column))[:, None]
        by = np.where(second, spread, 0.0) if form == "shifted" else np.where(second, side, -side) * spread / 2
        return as_log(replace(rows, actions=rows.actions + by, bounds=(low - spread.max(), high + spread.max())))

    return plant


def lonely(size: float, columns: float) -> Callable[[Kind, int], Log | None]:
    """One episode elsewhere: this share of the columns moved by `size` times their spread, all along."""

    def plant(kind: Kind, seed: int) -> Log | None:
        rows = kind.make(seed)
        if len(rows.starts) < 10:
            return None
        rng = np.random.default_rng([seed, 17])
        spread = rows.observations.std(axis=0)
        moving = np.flatnonzero(spread > 0)
        chosen = rng.choice(moving, max(1, round(columns * len(moving))), replace=False)
        shift = np.zeros(len(spread))
        shift[chosen] = size * spread[chosen] * rng.choice([-1, 1], len(chosen))
        away = rows.episode == rng.integers(len(rows.starts))
        return as_log(replace(rows, observations=rows.observations + away[:, None] * shift))

    return plant


JUMPS_ANYWAY = {
    "dosing, patient by patient": "each row is another patient: every step is a jump",
    "store": "stock and demand jump from day to day anyway",
    "noisy sensors": "the sensors' noise is as large as what a reset moves",
}
ONE_EPISODE = {"one long episode": "there is one episode, so no end inside the log"}
PATIENTS = {"dosing, patient by patient": "what is seen of the next patient depends on no action anyway"}
FOLLOWS = {"linear, feedback without noise": "each action follows from its row to the last digit: nothing was tried"}
SWITCH = {"thermostat, on and off": "on and off is all there is"}

FAULTS: dict[str, Fault] = {
    "no ends at all": Fault(
        ("reset-unmarked", "jump"), {f"every {n} rows": no_ends(n) for n in (20, 50, 200)}, JUMPS_ANYWAY | ONE_EPISODE
    ),
    "some ends lost": Fault(
        ("reset-unmarked", "jump"), {"one": lost_ends(0.0), "a fifth": lost_ends(0.2)}, JUMPS_ANYWAY | ONE_EPISODE
    ),
    "flags a row late": Fault(
        ("ends-late",),
        {
            "in a file": late_flags,
            "in memory": lambda kind, seed: in_memory(late_flags(kind, seed)),
        },
        JUMPS_ANYWAY | ONE_EPISODE,
    ),
    "flags a row late, successors logged": Fault(("ends-late",), {"": late_against_successors}, ONE_EPISODE),
    "successors by numpy.roll": Fault(
        ("ends-late",),
        {"in a file": rolled, "in memory": lambda kind, seed: in_memory(rolled(kind, seed))},
        JUMPS_ANYWAY | ONE_EPISODE,
    ),
    "flags that stay on": Fault(("flag-stays-on",), {f"{n} rows": staying(n) for n in (2, 5)}, ONE_EPISODE),
    "bounds too wide": Fault(
        ("bounds-too-wide",), {f"{n:g} times": wide(n) for n in (100, 1e6)} | {"largest number": wide(np.inf)}, {}
    ),
    "rewards in another unit": Fault(("reward-scale",), {f"times {n:g}": reward_times(n) for n in (1e6, 1e-6)}, {}),
    "best return of a fragment": Fault(
        ("returns-by-length",), {f"{n:.0%}": fragment(n) for n in (0.05, 0.2)}, ONE_EPISODE
    ),
    "a column holds the action": Fault(
        ("action-in-observations",),
        {
            "own row": holds_action(0, 1.0),
            "own row, percent": holds_action(0, 100.0),
            "own row, 1 % noise": holds_action(0, 1.0, 0.01),
            "next row": holds_action(1, 1.0),
            "next row, other unit": holds_action(1, 0.37),
        },
        {},
    ),
    "reward from one column": Fault(
        ("reward-from-one-column",),
        {
            "line, observation": reward_from("observations", "line"),
            "parabola, observation": reward_from("observations", "parabola"),
            "line, next observation": reward_from("next_observations", "line"),
            "parabola, action": reward_from("actions", "parabola"),
        },
        {},
    ),
    "dead time": Fault(
        ("dead-time",),
        {f"{n} rows": delayed(n) for n in (1, 2, 4)},
        PATIENTS
        | FOLLOWS
        | {"last action among observations": "a dead time of one row is no fault there: the remedy is taken already"},
    ),
    "actions change nothing": Fault(
        ("no-effect",), {"all": idle(True), "one of several": idle(False)}, PATIENTS | FOLLOWS
    ),
    "two controllers conflict": Fault(
        ("controllers-conflict",),
        {
            "sign turned, half of the episodes": otherwise(0.5, 0.0, "turned"),
            "shifted by 2 spreads, half": otherwise(0.5, 2.0, "shifted"),
            "shifted by 2 spreads, a fifth": otherwise(0.2, 2.0, "shifted"),
            "opposite by 2 spreads, half": otherwise(0.5, 2.0, "opposite"),
            "opposite by 2 spreads, a fifth": otherwise(0.2, 2.0, "opposite"),
        },
        ONE_EPISODE,
    ),
    "an episode elsewhere": Fault(
        ("lonely-episode",),
        {
            "all columns, 5 spreads": lonely(5.0, 1.0),
            "half of the columns, 10 spreads": lonely(10.0, 0.5),
        },
        ONE_EPISODE,
    ),
}

__all__ = ["FAULTS", "KINDS", "Fault", "as_log"]

# What is no fault but worth knowing: findings that are notes, judged apart from those that blame a log.
ADVICE: dict[str, Fault] = {
    "a few episodes earned far more": Fault(
        ("few-good-episodes",),
        {f"{share:.0%}, by {n} spreads": a_few_good(share, n) for share in (0.03, 0.1) for n in (6, 10)},
        ONE_EPISODE,
    )
}
