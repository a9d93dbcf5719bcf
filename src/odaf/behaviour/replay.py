"""Every step of an online run, in the order in which it was played, in one file that is read and written in place."""

from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Array, Float

from odaf.data.transitions import Transitions


@runtime_checkable
class Widths(Protocol):
    """How many numbers the columns of a row hold."""

    @property
    def obs_dim(self) -> int:
        """Of an observation."""
        ...

    @property
    def act_dim(self) -> int:
        """Of an action."""
        ...

    @property
    def positions(self) -> int:
        """Of `qpos`."""
        ...

    @property
    def velocities(self) -> int:
        """Of `qvel`."""
        ...


class Replay:
    """Steps of one run as packed rows: what the learner reads, then the ends and the body for later use.

    The file holds as many rows as the run has steps, so nothing is ever overwritten: the first N rows are the replay
    buffer as it was after N steps. A file that holds fewer grows when a run is made longer.
    """

    def __init__(self, path: Path, task: Widths, capacity: int):
        obs, act, body = task.obs_dim, task.act_dim, task.positions + task.velocities
        self.task = task
        self.width = 2 * obs + act + 2
        shape = (capacity, self.width + 1 + body)
        if path.exists():
            self.rows = np.load(path, mmap_mode="r+", allow_pickle=False)
            if self.rows.shape[1:] != shape[1:] or len(self.rows) > capacity:
                raise ValueError(f"{path}: holds {self.rows.shape}, expected {shape}; remove the folder to start anew")
            if len(self.rows) < capacity:
                longer = path.with_suffix(".longer.npy")
                rows = np.lib.format.open_memmap(longer, mode="w+", dtype=np.float32, shape=shape)
                rows[: len(self.rows)] = self.rows
                rows.flush()
                longer.replace(path)
                self.rows = np.load(path, mmap_mode="r+", allow_pickle=False)
        else:
            self.rows = np.lib.format.open_memmap(path, mode="w+", dtype=np.float32, shape=shape)

    def write(
        self,
        index: int,
        observation: np.ndarray,
        action: np.ndarray,
        reward: float,
        next_observation: np.ndarray,
        terminated: bool,
        truncated: bool,
        body: np.ndarray,
    ) -> None:
        """Writes step `index`; `body` is qpos and qvel before the step."""
        row = self.rows[index]
        obs, act = self.task.obs_dim, self.task.act_dim
        row[:obs] = observation
        row[obs : obs + act] = action
        row[obs + act] = reward
        row[obs + act + 1 : 2 * obs + act + 1] = next_observation
        row[2 * obs + act + 1] = terminated
        row[self.width] = truncated
        row[self.width + 1 :] = body

    def draw(self, indices: np.ndarray) -> np.ndarray:
        """[*indices, width]: the learner's part of the rows."""
        return self.rows[:, : self.width][indices]

    def columns(self, count: int) -> dict[str, np.ndarray]:
        """The first `count` steps, column by column."""
        obs, act = self.task.obs_dim, self.task.act_dim
        rows, body = np.array(self.rows[:count]), self.width + 1
        return {
            "observations": rows[:, :obs],
            "actions": rows[:, obs : obs + act],
            "rewards": rows[:, obs + act],
            "next_observations": rows[:, obs + act + 1 : 2 * obs + act + 1],
            "terminated": rows[:, self.width - 1] > 0.5,
            "truncated": rows[:, self.width] > 0.5,
            "qpos": rows[:, body : body + self.task.positions],
            "qvel": rows[:, body + self.task.positions :],
        }

    def flush(self) -> None:
        """Hands everything written to the disk."""
        self.rows.flush()


def unpack(rows: Float[Array, "batch width"], obs_dim: int, act_dim: int) -> Transitions:
    """The learner's view of packed rows."""
    return Transitions(
        observations=rows[:, :obs_dim],
        actions=rows[:, obs_dim : obs_dim + act_dim],
        rewards=rows[:, obs_dim + act_dim],
        next_observations=rows[:, obs_dim + act_dim + 1 : 2 * obs_dim + act_dim + 1],
        terminated=rows[:, 2 * obs_dim + act_dim + 1],
    )
