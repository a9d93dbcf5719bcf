"""Logged rows as their source holds them, before any judgement: what every reader returns.

A reader finds columns and says what they mean; it neither repairs nor drops. `odaf.data.checks` judges a log,
`Dataset.from_log` turns it into a `Dataset` or refuses it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import numpy as np

from odaf.data.mixture import Mixture
from odaf.data.progress import Counter
from odaf.data.validation import Bounds, RowNumbers

REQUIRED = ("observations", "actions", "rewards")
OPTIONAL = ("next_observations", "terminated", "truncated", "episode", "time")


@runtime_checkable
class Column(Protocol):
    """A NumPy array, a memory map, or an array in a file that is read piece by piece."""

    @property
    def shape(self) -> tuple[int, ...]: ...

    @property
    def dtype(self) -> Any: ...

    def __len__(self) -> int: ...

    def __getitem__(self, key: Any, /) -> Any: ...


@dataclass(frozen=True, eq=False)
class Log:
    """Columns of equal meaning from any source; N rows in time order inside each episode.

    Attributes:
        columns: by field: `observations` [N, obs_dim], `actions` [N, act_dim], `rewards` [N] or [N, 1], and, where the
            source has them, `next_observations` [N, obs_dim], `terminated` [N], `truncated` [N], `episode` [N] ids and
            `time` [N] (seconds, or the number of the step). Types and lengths are those of the source, not yet checked.
        source: how messages name it, for instance a file name.
        format: the format's name, such as `d4rl`.
        observation_names: one per column of `observations`, where known.
        action_names: one per column of `actions`.
        observation_units: one per column of `observations`.
        action_units: one per column of `actions`.
        action_bounds: (low, high) or {action name: (low, high)}, where known.
        infos: further columns to keep beside the rows, by name.
        provenance: JSON types: what the source says of itself.
        findings: what the reader had to decide, in the form of `Dataset.provenance["findings"]`.
        mixture: how batches of these rows are mixed, known only to files of ours.
        row_numbers: [N] number of each row in the source, as messages should give it, such as `range(2, N + 2)` for a
            CSV file with a heading; None counts from 0.
    """

    columns: Mapping[str, Column]
    source: str
    format: str
    observation_names: tuple[str, ...] | None = None
    action_names: tuple[str, ...] | None = None
    observation_units: tuple[str, ...] | None = None
    action_units: tuple[str, ...] | None = None
    action_bounds: Bounds | None = None
    infos: Mapping[str, Column] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    findings: tuple[Mapping[str, Any], ...] = ()
    mixture: Mixture | None = None
    row_numbers: RowNumbers | None = None

    def __len__(self) -> int:
        return len(self.columns["observations"])

    def blocks(self, rows: int = 65_536) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
        """(first row, columns as arrays) of consecutive pieces, so that a log larger than memory can be passed over."""
        for first in range(0, len(self), rows):
            yield first, {name: np.asarray(column[first : first + rows]) for name, column in self.columns.items()}


def whole(column: Column, counter: Counter) -> np.ndarray:
    """The column in memory; an array as it is, because a slice of it would look as if somebody else could change it."""
    if type(column) is np.ndarray:
        counter.add(len(column))
        return column
    values = np.asarray(column[:])
    counter.add(len(column))
    if values.flags.owndata:
        values.setflags(write=False)  # read for us alone: the dataset may keep it uncopied
    return values
