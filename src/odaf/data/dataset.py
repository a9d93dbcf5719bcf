"""Logged experience: immutable columns, an episode index, and where it all came from."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import InitVar, dataclass, replace
from typing import Any, Literal

import numpy as np

from odaf.data import assembly, fingerprint, splits, summary, validation
from odaf.data.checks import Report, check_log
from odaf.data.log import Log, whole
from odaf.data.progress import Counter, Progress
from odaf.data.rows import COLUMNS, Rows
from odaf.errors import DatasetError


@dataclass(frozen=True, eq=False)
class Dataset(Rows):
    """N transitions of E whole episodes, in the user's units. Arrays are read-only and rows never cross an episode.

    Two ends are told apart. `terminated` means the task ended: no future reward exists after this row. `truncated`
    means the recording ended: the future went on unseen, and `next_observations` holds the real successor. A pole that
    falls at step 30 has `terminated[29]`; one still standing when the 200-step clock runs out has `truncated[199]`.
    The last row of an episode carries exactly one of the two; no other row carries any.

    Use `from_arrays` or `load`; the constructor takes columns that are already in final form and checks them.

    Attributes are those of `odaf.data.rows.Rows`: columns, episodes, action bounds, names, units and provenance.
    """

    source: InitVar[str] = "Dataset"  # how messages name these rows

    def __post_init__(self, source: str):
        own = assembly.checked(self, source)
        for value in (*own.values(), *own["infos"].values()):
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        for name, value in own.items():
            object.__setattr__(self, name, value)

    @classmethod
    def from_arrays(
        cls,
        observations: Any,
        actions: Any,
        rewards: Any,
        next_observations: Any = None,
        terminated: Any = None,
        truncated: Any = None,
        *,
        episode: Any = None,
        action_bounds: validation.Bounds | None = None,
        observation_names: Sequence[str] | None = None,
        action_names: Sequence[str] | None = None,
        observation_units: Sequence[str] | None = None,
        action_units: Sequence[str] | None = None,
        infos: Mapping[str, Any] | None = None,
        provenance: Mapping[str, Any] | None = None,
        source: str = "Dataset.from_arrays",
        row_numbers: validation.RowNumbers | None = None,
    ) -> "Dataset":
        """Builds a dataset from columns in time order; the caller's arrays are copied, never changed.

        Episodes are the blocks of equal `episode` ids; without ids an episode ends at each row that is terminated or
        truncated. Everything that is changed, derived or dropped is counted in `provenance["findings"]`.

        Args:
            observations: [N, obs_dim].
            actions: [N, act_dim], in the units of `action_bounds`.
            rewards: [N] or [N, 1].
            next_observations: [N, obs_dim]. None shifts `observations` inside each episode; a last row that is
                not terminated has then no successor and is dropped (it cannot be learned from).
            terminated: [N], true where the task ended. None means it never did.
            truncated: [N], true where the recording was cut. None means only where an episode stops unfinished.
            episode: [N] ids, equal inside an episode and never used again by a later one.
            action_bounds: (low, high), numbers or one per action, or {action name: (low, high)}. None takes the
                smallest and largest logged action, which is recorded as a finding.
            observation_names: one per column; None numbers them.
            action_names: one per column; None numbers them.
            observation_units: one per column, for instance "m/s"; None leaves them empty.
            action_units: one per column.
            infos: further columns to keep beside the rows, {name: [N, ...]}; learners do not see them.
            provenance: JSON types, stored with the data.
            source: how error messages name these rows, for instance a file name.
            row_numbers: [N] whole numbers that messages and findings give the rows, such as `range(2, N + 2)` for those
                of a spreadsheet under its headings; None counts from 0.

        Raises:
            DatasetError: a column has the wrong type, shape or length, holds NaN or infinity, actions lie outside their
                bounds by more than 0.1 % of the range, no episode end can be told, or an episode id comes back.
        """
        fields = assembly.completed(
            source,
            {
                "observations": observations,
                "actions": actions,
                "rewards": rewards,
                "next_observations": next_observations,
                "terminated": terminated,
                "truncated": truncated,
            },
            episode=episode,
            action_bounds=action_bounds,
            observation_names=observation_names,
            action_names=action_names,
            infos=infos or {},
            provenance=provenance or {},
            row_numbers=row_numbers,
        )
        return cls(
            **fields,
            observation_units=None if observation_units is None else tuple(observation_units),
            action_units=None if action_units is None else tuple(action_units),
            source=source,
        )

    @classmethod
    def from_dataframe(
        cls,
        frame: Any,
        *,
        observations: Sequence[str],
        actions: Sequence[str],
        reward: str | float,
        episode: str | int | None = None,
        terminated: str | None = None,
        truncated: str | None = None,
        time: str | None = None,
        next_observations: Sequence[str] | None = None,
        action_bounds: validation.Bounds | None = None,
        units: Mapping[str, str] | Literal["headings"] | None = None,
        **options: Any,
    ) -> "Dataset":
        """Builds a dataset from named columns of a polars or pandas frame, or of a mapping from names to arrays.

        Args:
            frame: the table; rows in time order inside each episode.
            observations: columns that say what was seen before the action.
            actions: columns that say what was done.
            reward: the column of what the action of the same row earned.
            episode: the column of ids, equal for the rows of one episode; a number if all rows are one episode; None
                if an episode ends at each row that is terminated or truncated.
            terminated: the column that says where the task ended.
            truncated: the column that says where the recording was cut.
            time: the column of times; episodes end where rows are missing.
            next_observations: columns of what was seen after the action. None takes those of the next row.
            action_bounds: {column: (low, high)}. None takes the smallest and largest logged action.
            units: {column: unit}, or "headings" to part headings such as `level [m]` into name and unit.
            options: `sort_by`, `on_gap` and others, as in `odaf.data.readers.tables.read`.

        Raises:
            DatasetError: as `odaf.data.readers.tables.read` and `from_arrays`.
        """
        from odaf.data.readers import tables

        log = tables.from_frame(
            frame,
            observations=observations,
            actions=actions,
            reward=reward,
            episode=episode,
            terminated=terminated,
            truncated=truncated,
            time=time,
            next_observations=next_observations,
            action_bounds=action_bounds,
            units=units,
            source="Dataset.from_dataframe",
            **options,
        )
        return cls.from_log(log)

    @classmethod
    def from_episodes(
        cls,
        episodes: Sequence[Mapping[str, Any]],
        *,
        action_bounds: validation.Bounds | None = None,
        observation_names: Sequence[str] | None = None,
        action_names: Sequence[str] | None = None,
        observation_units: Sequence[str] | None = None,
        action_units: Sequence[str] | None = None,
        provenance: Mapping[str, Any] | None = None,
    ) -> "Dataset":
        """Builds a dataset from episodes of different lengths, each a mapping from field to array.

        Args:
            episodes: each with `observations`, `actions` [T, act_dim] and `rewards` [T], and where known `terminated`
                and `truncated`, as [T] or one bool for the end. Of T + 1 observations the last is what followed the
                last action; of T it is unknown, and a last row that is not terminated is dropped.
            action_bounds: as in `from_arrays`, like the other arguments.

        Raises:
            DatasetError: as `odaf.data.episode_lists.read` and `from_arrays`.
        """
        from odaf.data import episode_lists

        names = (observation_names, action_names, observation_units, action_units)
        given = [None if name is None else tuple(name) for name in names]
        log = episode_lists.read(
            episodes,
            source="Dataset.from_episodes",
            action_bounds=action_bounds,
            observation_names=given[0],
            action_names=given[1],
            observation_units=given[2],
            action_units=given[3],
            provenance=dict(provenance or {}),
        )
        return cls.from_log(log)

    @classmethod
    def from_log(cls, log: Log, progress: Progress | None = None) -> "Dataset":
        """The rows that a reader of `odaf.data.readers` returned, as a dataset in memory.

        Args:
            log: the rows as their source holds them.
            progress: told how far it has come, in values of columns read.

        Raises:
            DatasetError: as `from_arrays`.
        """
        wanted = {name: column for name, column in log.columns.items() if name != "time"}
        counter = Counter(sum(len(column) for column in (*wanted.values(), *log.infos.values())), progress)
        dataset = cls.from_arrays(
            **{name: whole(column, counter) for name, column in wanted.items()},
            action_bounds=log.action_bounds,
            observation_names=log.observation_names,
            action_names=log.action_names,
            observation_units=log.observation_units,
            action_units=log.action_units,
            infos={name: whole(column, counter) for name, column in log.infos.items()},
            provenance={**log.provenance, "format": log.format, "findings": list(log.findings)},
            source=log.source,
            row_numbers=log.row_numbers,
        )
        return dataset if log.mixture is None else replace(dataset, mixture=log.mixture, source=log.source)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        format: str | None = None,
        progress: Progress | None = None,
        **options: Any,
    ) -> "Dataset":
        """Reads a file written by `save`, or a file or folder in one of the layouts of `odaf.data.readers`.

        Reading never runs code from the file.

        Args:
            path: file or folder.
            format: a name in `odaf.data.readers.FORMATS`; None tells the layout from the contents.
            progress: told how far it has come, as (done, all there is to do).
            options: of the layout's own reader: `max_episode_steps`, `action_bounds` and `d4rl_compat` for D4RL files
                (`odaf.data.readers.d4rl.read`), `observations=[...]` and more for tables. None counts as not given.

        Raises:
            DatasetError: there is nothing at `path`, it is damaged, of an unknown format or a newer version, an option
                does not belong to its layout, or its rows fail a check.
        """
        from odaf.data import readers, storage

        given = {name: value for name, value in options.items() if value is not None}
        if format is not None or not storage.is_own_file(path):
            return cls.from_log(readers.read(path, format=format, **given), progress)
        with storage.opened(path) as (file, source):
            for option, value in given.items():
                if value is not False:
                    raise DatasetError(
                        f"{source}: {option} applies to files in the D4RL layout and others like it, this is an odaf "
                        "dataset; leave the option out"
                    )
            return cls(**storage.read(file, source, progress), source=source)

    def save(self, path: str | os.PathLike[str], progress: Progress | None = None) -> None:
        """Writes the dataset to one HDF5 file; a crash leaves either the old file or the new one, never a part.

        Args:
            path: the file.
            progress: told how far it has come, as (done, all there is to do).
        """
        from odaf.data import storage

        storage.write(self, path, progress)

    def fingerprint(self) -> str:
        """SHA-256 (hex) over what a learner sees: columns, ends, action bounds, names of columns, mixture.

        `odaf.resume` goes on with data of the same fingerprint. Provenance, units and infos are no part of it.
        """
        return fingerprint.of_rows(self)

    def file_fingerprint(self) -> str:
        """SHA-256 (hex) over all arrays and the metadata, as it stands in a saved file: equal files, equal print."""
        return fingerprint.of_file(self)

    def check(self) -> Report:
        """What may trouble learning from these rows, each with row numbers and a remedy; print it to see a table.

        Data sets of this class have passed what would be an error in a file; warnings and notes are left, and what was
        changed on the way in.
        """
        return check_log(self.to_log())

    def with_provenance(self, **entries: Any) -> "Dataset":
        """The same rows with further entries in `provenance`, or others in the place of old ones; JSON types."""
        return replace(self, provenance={**self.provenance, **entries}, source="Dataset.with_provenance")

    def to_log(self) -> Log:
        """The same rows as a reader would return them; no array is copied."""
        columns: dict[str, Any] = {name: getattr(self, name) for name in COLUMNS}
        columns["episode"] = np.repeat(np.arange(self.num_episodes), self.episode_lengths())
        return Log(
            columns=columns,
            source="Dataset",
            format="odaf",
            observation_names=self.observation_names,
            action_names=self.action_names,
            observation_units=self.observation_units,
            action_units=self.action_units,
            action_bounds=(self.action_low, self.action_high),
            infos=self.infos,
            provenance=self.provenance,
            mixture=self.mixture,
            findings=tuple(self.provenance.get("findings", ())),
        )

    def summary(self) -> dict[str, Any]:
        """Counts, returns and provenance in JSON types. Returns are undiscounted sums per episode."""
        return summary.summarise(self)

    def select(self, chosen: Sequence[int] | np.ndarray) -> "Dataset":
        """A dataset of the episodes `chosen`, in that order; at least one, and of a mixture some of both parts."""
        return replace(self, **splits.selected(self, chosen), source="Dataset.select")

    def split(self, holdout: float = 0.2, seed: int = 0) -> tuple["Dataset", "Dataset"]:
        """(train, holdout): whole episodes, drawn without replacement; both parts keep the order of the log.

        Args:
            holdout: share of the episodes to set aside, in (0, 1); rounded, at least one episode on each side.
            seed: the same seed sets the same episodes aside.
        """
        train, held = (
            self.select(chosen).with_provenance(split={"part": name, "holdout": holdout, "seed": seed})
            for name, chosen in splits.drawn(self.num_episodes, holdout, seed).items()
        )
        return train, held
