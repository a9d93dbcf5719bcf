"""What the caller says of a table: which column stands for what, and how its rows are to be understood."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from odaf.data.readers.row_order import OnGap
from odaf.data.readers.table_cells import OnMissing
from odaf.data.validation import Bounds
from odaf.errors import DatasetError

Units = Mapping[str, str] | Literal["headings"]


@dataclass(frozen=True)
class Meaning:
    """What the columns of a table stand for and how its rows are to be understood; see `tables.read` for each."""

    observations: Sequence[str]
    actions: Sequence[str]
    reward: str | float
    episode: str | int | None = None
    terminated: str | None = None
    truncated: str | None = None
    time: str | None = None
    next_observations: Sequence[str] | None = None
    infos: Sequence[str] = ()
    action_bounds: Bounds | None = None
    units: Units | None = None
    time_step: float | None = None
    time_format: str | None = None
    sort_by: Sequence[str] = ()
    on_gap: OnGap = "break"
    on_missing: OnMissing = "error"

    def numeric(self) -> list[str]:
        """Names of the columns that hold numbers."""
        reward = [self.reward] if isinstance(self.reward, str) else []
        return [*self.observations, *self.actions, *reward, *(self.next_observations or ()), *self.infos]

    def columns(self) -> list[str]:
        """Names of all columns that are needed, each once."""
        others = (self.episode, self.terminated, self.truncated, self.time)
        named = [name for name in others if isinstance(name, str)]
        return list(dict.fromkeys([*self.numeric(), *named, *self.sort_by]))

    def check(self, source: str) -> None:
        """Raises where the settings contradict each other."""
        for field in ("observations", "actions", "next_observations", "infos", "sort_by"):
            value = getattr(self, field)
            if isinstance(value, str):
                raise DatasetError(f"{source}: {field} is the text {value!r}; give a list of names, as [{value!r}]")
        for field in ("observations", "actions"):
            if not getattr(self, field):
                raise DatasetError(f"{source}: {field} names no column; name at least one")
        if self.on_gap not in get_args(OnGap):
            raise DatasetError(f"{source}: on_gap is {self.on_gap!r}; choose 'error' or 'break'")
        if self.on_missing not in get_args(OnMissing):
            raise DatasetError(f"{source}: on_missing is {self.on_missing!r}; choose 'error' or 'nan'")
        if self.time is None and (self.time_step is not None or self.time_format is not None):
            raise DatasetError(f"{source}: time_step and time_format explain a time column; name it with time=")
        if self.time_step is not None and not 0.0 < self.time_step < float("inf"):
            raise DatasetError(f"{source}: time_step is {self.time_step}; give the time between rows, above 0")
        if isinstance(self.units, str) and self.units != "headings":
            raise DatasetError(f"{source}: units is {self.units!r}; give {{column: unit}}, or 'headings' to read them")
        if self.next_observations is not None and len(self.next_observations) != len(self.observations):
            raise DatasetError(
                f"{source}: next_observations names {len(self.next_observations)} columns, observations "
                f"{len(self.observations)}; name the same quantities in the same order"
            )
