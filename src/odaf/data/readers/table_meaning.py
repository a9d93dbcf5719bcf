"""What the caller says of a table: which column stands for what, and how its rows are to be understood."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, get_args

from odaf.data import expressions
from odaf.data.derived import read_by
from odaf.data.expressions import Expression
from odaf.data.readers.row_order import OnGap
from odaf.data.readers.table_cells import OnMissing
from odaf.data.readers.table_sources import require
from odaf.data.validation import Bounds
from odaf.errors import DatasetError

Units = Mapping[str, str] | Literal["headings"]


@dataclass(frozen=True)
class Roles:
    """Which columns of a table play which part, once its headings are known.

    Attributes:
        parts: of the observations, in order: a column, or a name with its formula.
        reward: a column, a formula, or what every row earned.
        columns: all columns that are needed, each once.
        direct: those of them that a learner sees as they are.
        computed: those of them that formulas take.
    """

    parts: tuple[tuple[str, Expression | None], ...]
    reward: str | float | Expression
    columns: tuple[str, ...]
    direct: tuple[str, ...]
    computed: tuple[str, ...]


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
    missing_values: Sequence[str] = field(default=())
    lags: int = 0
    differences: bool = False

    def hints(self) -> list[str]:
        """Names that may be columns, told without the headings."""
        reward = [self.reward] if isinstance(self.reward, str) else []
        others = (self.episode, self.terminated, self.truncated, self.time)
        named = [name for name in others if isinstance(name, str)]
        listed = [*self.observations, *reward, *self.actions, *(self.next_observations or ()), *self.infos]
        words = [word for text in (*self.observations, *reward) for word in _words(text)]
        return [*listed, *named, *self.sort_by, *words]

    def roles(self, source: str, names: Sequence[str]) -> Roles:
        """Which of the table's columns play which part.

        Raises:
            DatasetError: a column is missing, or a formula cannot be read.
        """
        parts: list[tuple[str, Expression | None]] = []
        for text in self.observations:
            formula = None if text in names else expressions.named(text)
            if formula is None:
                parts.append((text, None))
                continue
            name, body = formula
            if name in names or name in dict(parts):
                raise DatasetError(
                    f"{source}: observation '{text}': there is a column '{name}' already; give it another name"
                )
            earlier = [name for name, made in parts if made is not None]
            parts.append((name, _parsed(source, body, [*names, *earlier])))
        reward: str | float | Expression = self.reward
        if isinstance(reward, str) and reward not in names and expressions.looks_like_one(reward):
            reward = _parsed(source, reward, names)
        computed = [name for name in read_by([part for part in parts if part[1] is not None])]
        computed += reward.columns if isinstance(reward, Expression) else ()
        direct = [name for name, formula in parts if formula is None]
        direct += [*self.actions, *(self.next_observations or ())]
        direct += [reward] if isinstance(reward, str) else []
        others = (self.episode, self.terminated, self.truncated, self.time)
        named = [name for name in others if isinstance(name, str)]
        columns = dict.fromkeys([*direct, *self.infos, *named, *computed, *self.sort_by])
        require(source, names, columns)
        return Roles(tuple(parts), reward, tuple(columns), tuple(dict.fromkeys(direct)), tuple(dict.fromkeys(computed)))

    def check(self, source: str) -> None:
        """Raises where the settings contradict each other."""
        for name in ("observations", "actions", "next_observations", "infos", "sort_by"):
            value = getattr(self, name)
            if isinstance(value, str):
                raise DatasetError(
                    f"{source}: {name} is the text {value!r}; give a list of names, as {name}=[{value!r}]"
                )
        if isinstance(self.missing_values, str):
            words = self.missing_values
            raise DatasetError(f"{source}: missing_values is the text {words!r}; give a list, as ['Bad', 'No Data']")
        for name in ("observations", "actions"):
            if not getattr(self, name):
                raise DatasetError(f"{source}: {name} names no column; name at least one")
        if self.on_gap not in get_args(OnGap):
            raise DatasetError(f"{source}: on_gap is {self.on_gap!r}; choose 'error' or 'break'")
        if self.on_missing not in get_args(OnMissing):
            raise DatasetError(f"{source}: on_missing is {self.on_missing!r}; choose 'error', 'break' or 'nan'")
        if self.time is None and (self.time_step is not None or self.time_format is not None):
            raise DatasetError(f"{source}: time_step= and time_format= explain a time column; name it with time=")
        if self.time_step is not None and not 0.0 < self.time_step < float("inf"):
            raise DatasetError(f"{source}: time_step is {self.time_step}; give the time between rows, above 0")
        if isinstance(self.units, str) and self.units != "headings":
            raise DatasetError(f"{source}: units is {self.units!r}; give {{column: unit}}, or 'headings' to read them")
        if self.lags < 0:
            raise DatasetError(f"{source}: lags is {self.lags}; give the number of earlier rows to see, 0 or more")
        if self.next_observations is not None:
            self._check_successors(source, self.next_observations)

    def _check_successors(self, source: str, successors: Sequence[str]) -> None:
        if len(successors) != len(self.observations):
            raise DatasetError(
                f"{source}: next_observations names {len(successors)} columns, observations "
                f"{len(self.observations)}; name the same quantities in the same order"
            )
        if self.lags or self.differences or any(map(expressions.named, self.observations)):
            raise DatasetError(
                f"{source}: next_observations= gives successors without formulas, lags and differences; leave it out, "
                "then the next row of the episode is taken"
            )


def _parsed(source: str, text: str, names: Sequence[str]) -> Expression:
    try:
        return expressions.parse(text, names)
    except DatasetError as error:
        raise DatasetError(f"{source}: {error}") from error


def _words(text: str) -> list[str]:
    """What may be columns in a formula; nothing where the text is no formula."""
    try:
        return list(expressions.parse((expressions.named(text) or ("", text))[1]).columns)
    except DatasetError:
        return []
