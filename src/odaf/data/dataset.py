"""Logged experience: immutable columns, an episode index, and where it all came from."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import InitVar, dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from odaf.data import assembly, fingerprint, splits, summary, validation
from odaf.data.log import Log
from odaf.data.mixture import Mixture
from odaf.data.progress import Progress
from odaf.data.spec import Spec
from odaf.errors import DatasetError

if TYPE_CHECKING:
    from odaf.data.checks import Report

COLUMNS = ("observations", "actions", "rewards", "next_observations", "terminated", "truncated")


@dataclass(frozen=True, eq=False)
class Dataset:
    """N transitions of E whole episodes, in the user's units. Arrays are read-only and rows never cross an episode.

    Two ends are told apart. `terminated` means the task ended: no future reward exists after this row. `truncated`
    means the recording ended: the future went on unseen, and `next_observations` holds the real successor. A pole that
    falls at step 30 has `terminated[29]`; one still standing when the 200-step clock runs out has `truncated[199]`.
    The last row of an episode carries exactly one of the two; no other row carries any.

    Use `from_arrays` or `load`; the constructor takes columns that are already in final form and checks them.

    Attributes:
        observations: [N, obs_dim] float32.
        actions: [N, act_dim] float32, within `action_low` and `action_high`.
        rewards: [N] float32, earned by the action of the same row.
        next_observations: [N, obs_dim] float32; a placeholder where `terminated` and no successor was logged.
        terminated: [N] bool.
        truncated: [N] bool.
        episode_starts: [E] int64, the first row of each episode, ascending from 0.
        action_low: [act_dim] float32.
        action_high: [act_dim] float32.
        observation_names: one per observation column.
        action_names: one per action column.
        provenance: JSON types only: where the rows came from, and under "findings" what was changed on the way in.
        observation_units: one per observation column, for instance "m/s"; empty where none was given.
        action_units: one per action column.
        infos: further columns that learners do not see, by name: each [N, ...] numbers or bool, such as `qpos`.
        mixture: how batches are mixed from two parts; None draws every row equally often. See `odaf.data.mixing`.
    """

    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    next_observations: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    episode_starts: np.ndarray
    action_low: np.ndarray
    action_high: np.ndarray
    observation_names: tuple[str, ...]
    action_names: tuple[str, ...]
    provenance: dict[str, Any]
    observation_units: tuple[str, ...] | None = None
    action_units: tuple[str, ...] | None = None
    infos: Mapping[str, np.ndarray] = field(default_factory=dict)
    mixture: Mixture | None = None
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
        return log.to_dataset()

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
        return log.to_dataset()

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
            return readers.read(path, format=format, **given).to_dataset(progress)
        with storage.opened(path) as (file, source):
            for option, value in given.items():
                if value is not False:
                    raise DatasetError(
                        f"{source}: {option} applies to files in the D4RL layout and others like it, this is an odaf "
                        "dataset; leave the option out"
                    )
            return storage.read(file, source, progress)

    def save(self, path: str | os.PathLike[str], progress: Progress | None = None) -> None:
        """Writes the dataset to one HDF5 file; a crash leaves either the old file or the new one, never a part.

        Args:
            path: the file.
            progress: told how far it has come, as (done, all there is to do).
        """
        from odaf.data import storage

        storage.write(self, path, progress)

    def __len__(self) -> int:
        return len(self.rewards)

    @property
    def obs_dim(self) -> int:
        return self.observations.shape[1]

    @property
    def act_dim(self) -> int:
        return self.actions.shape[1]

    @property
    def num_episodes(self) -> int:
        return len(self.episode_starts)

    @property
    def environment(self) -> dict[str, Any] | None:
        """How to build the environment the data came from (see `odaf.environments.make`), or None if unknown."""
        return self.provenance.get("environment")

    def episode(self, index: int) -> slice:
        """Rows of one episode; negative indices count from the end."""
        if not -self.num_episodes <= index < self.num_episodes:
            raise IndexError(f"episode {index} of {self.num_episodes}")
        index %= self.num_episodes
        stop = self.episode_starts[index + 1] if index + 1 < self.num_episodes else len(self)
        return slice(int(self.episode_starts[index]), int(stop))

    def episode_lengths(self) -> np.ndarray:
        """[E] int64, steps."""
        return np.append(self.episode_starts[1:], len(self)).astype(np.int64) - self.episode_starts

    def episode_returns(self) -> np.ndarray:
        """[E] float64, undiscounted sums of the logged rewards."""
        return np.add.reduceat(self.rewards.astype(np.float64), self.episode_starts)

    def spec(self) -> Spec:
        """What a learner needs to size its networks and scale its actions."""
        return Spec(
            obs_dim=self.obs_dim,
            act_dim=self.act_dim,
            action_low=tuple(self.action_low.tolist()),
            action_high=tuple(self.action_high.tolist()),
            reward_min=float(self.rewards.min()),
            reward_max=float(self.rewards.max()),
            ever_terminates=bool(self.terminated.any()),
            max_episode_length=int(self.episode_lengths().max()),
        )

    def fingerprint(self) -> str:
        """SHA-256 (hex) over names, types, shapes and bytes of all arrays and the metadata; equal data, equal print."""
        return fingerprint.checksum(fingerprint.arrays_of(self), fingerprint.metadata(self))

    def check(self) -> "Report":
        """What may trouble learning from these rows, each with row numbers and a remedy; print it to see a table.

        Data sets of this class have passed what would be an error in a file; warnings and notes are left, and what was
        changed on the way in.
        """
        from odaf.data.checks import check_log

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
        return splits.select(self, chosen)

    def split(self, holdout: float = 0.2, seed: int = 0) -> tuple["Dataset", "Dataset"]:
        """(train, holdout): whole episodes, drawn without replacement; both parts keep the order of the log.

        Args:
            holdout: share of the episodes to set aside, in (0, 1); rounded, at least one episode on each side.
            seed: the same seed sets the same episodes aside.
        """
        return splits.split(self, holdout, seed)
