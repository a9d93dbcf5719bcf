"""Rows of a log for a side model: some episodes to train on, the others to measure its error on."""

import dataclasses

import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, PRNGKeyArray

from odaf.components.fitting import EarlyStopping, OfRows
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser
from odaf.errors import DatasetError

HOLDOUT_ROWS = 20_000  # measured at most, in reports and for early stopping

Rows = tuple[Array, Array, Array]  # states, actions, next states
HostRows = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclasses.dataclass(frozen=True)
class SplitRows:
    """Rows that a side model trains on, and after them those that are held out, on the device.

    How many rows there are in all does not depend on the key that splits them, so neither do compiled programs.
    """

    columns: Rows
    train: int
    """Rows to train on, from the first on."""

    @property
    def total(self) -> int:
        """Rows in all."""
        return self.columns[0].shape[0]

    @property
    def last_measured(self) -> int:
        """Row to stop before when an error is measured from row `train` on."""
        return min(self.total, self.train + HOLDOUT_ROWS)

    def training(self) -> HostRows:
        """The rows to train on, on the host."""
        return self._on_host(0, self.train)

    def measured(self) -> HostRows:
        """The held-out rows that an error is measured on, on the host."""
        return self._on_host(self.train, self.last_measured)

    def stopping(self, error: OfRows, patience: int | None) -> EarlyStopping | None:
        """Early stopping by an error of the measured rows; None without patience."""
        return None if patience is None else EarlyStopping(error, self.train, self.last_measured, patience)

    def _on_host(self, first: int, last: int) -> HostRows:
        states, actions, next_states = (np.asarray(column)[first:last] for column in self.columns)
        return states, actions, next_states


def split_columns(
    dataset: Dataset,
    normaliser: Normaliser,
    share: float,
    key: PRNGKeyArray,
    model: str,
    remedy: str,
    *,
    needs_successors: bool = True,
) -> SplitRows:
    """The rows of `split_rows` as a learner sees them.

    Raises:
        DatasetError: as `split_rows`.
    """
    train, holdout = split_rows(dataset, share, key, model, remedy, needs_successors=needs_successors)
    return SplitRows(normalised_rows(dataset, normaliser, np.concatenate([train, holdout])), len(train))


def split_rows(
    dataset: Dataset, share: float, key: PRNGKeyArray, model: str, remedy: str, *, needs_successors: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Row indices of the training and hold-out episodes, at least one on each side; a single episode is cut in time.

    Args:
        dataset: the log.
        share: of the episodes, held out.
        key: random key that chooses them.
        model: what is trained, named in error messages.
        remedy: how to do without it, for the same messages.
        needs_successors: whether rows whose successor was not recorded are left out.

    Raises:
        DatasetError: fewer than two rows are left.
    """
    # a terminated row without a recorded successor repeats its own state; it would teach "no change"
    lacking = dataset.terminated & np.all(dataset.observations == dataset.next_observations, axis=1)
    known = ~lacking if needs_successors else np.ones(len(dataset), bool)
    rows_by_episode = np.split(np.arange(len(dataset)), dataset.episode_starts[1:])
    usable = [rows[known[rows]] for rows in rows_by_episode if np.any(known[rows])]
    if sum(len(rows) for rows in usable) < 2 and not needs_successors:
        raise DatasetError(f"{model}: the log has {len(dataset)} row; at least 2 are needed, or {remedy}")
    if sum(len(rows) for rows in usable) < 2:
        raise DatasetError(
            f"{model}: of {len(dataset):,} rows {int(known.sum())} have a logged successor; at least 2 must; "
            f"log the state after each action (next_observations), or {remedy}"
        )
    if len(usable) == 1:
        rows = usable[0]
        cut = min(max(1, int(len(rows) * (1.0 - share))), len(rows) - 1)
        return rows[:cut], rows[cut:]
    order = np.asarray(jr.permutation(key, len(usable)))
    count = min(max(1, round(share * len(usable))), len(usable) - 1)
    train, holdout = ([usable[index] for index in np.sort(side)] for side in (order[count:], order[:count]))
    return np.concatenate(train), np.concatenate(holdout)


def normalised_rows(dataset: Dataset, normaliser: Normaliser, rows: np.ndarray) -> Rows:
    """Columns of some rows as a learner sees them, on the device."""
    low, high = dataset.action_low, dataset.action_high
    actions = 2.0 * (dataset.actions[rows] - low) / (high - low) - 1.0
    return (
        jnp.asarray(normaliser.normalise(dataset.observations[rows]), dtype=jnp.float32),
        jnp.asarray(actions, dtype=jnp.float32),
        jnp.asarray(normaliser.normalise(dataset.next_observations[rows]), dtype=jnp.float32),
    )
