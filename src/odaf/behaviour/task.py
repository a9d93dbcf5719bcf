"""The contract between the online loop and what it trains for: a body that plays, a learner, and a judgement."""

import abc
from collections.abc import Mapping
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from odaf.algorithms.base import Algorithm
from odaf.data.spec import Spec
from odaf.environments.contact_margins import ContactMargins
from odaf.environments.gaussian_policy import GaussianPolicy


@runtime_checkable
class Body(Protocol):
    """One body in a simulator, with the task that it is paid for; the time limit is the loop's to keep."""

    def reset(self, seed: int) -> np.ndarray:
        """Starts an episode; the seed fixes the start and whatever else is drawn."""
        ...

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool]:
        """Plays an action in [-1, 1]: next observation, reward, whether the task truly ended."""
        ...

    def body(self) -> np.ndarray:
        """`qpos` and `qvel` in one array, a copy."""
        ...

    def physics(self) -> np.ndarray:
        """Everything that is needed to go on exactly from here."""
        ...

    def restore(self, physics: np.ndarray) -> None:
        """Goes back to a state that `physics` returned."""
        ...


class OnlineTask(abc.ABC):
    """What a run trains for.

    Attributes:
        environment: how records call it.
        obs_dim: numbers in an observation.
        act_dim: numbers in an action, each in [-1, 1].
        positions: numbers in the simulator's `qpos`.
        velocities: numbers in its `qvel`.
        time_limit: steps after which an episode is cut.
        terminates: whether an episode can truly end.
        usual: settings of a run, by their names in `OnlineRun`, that this task is meant to be trained with.
    """

    environment: str
    obs_dim: int
    act_dim: int
    positions: int
    velocities: int
    time_limit: int
    terminates: bool
    usual: ClassVar[Mapping[str, Any]]

    @abc.abstractmethod
    def body(self, contact_margins: ContactMargins | None) -> Any:
        """A fresh `Body`; None counts margins as the task is usually played."""

    @abc.abstractmethod
    def learner(self, batch_size: int) -> Algorithm[Any]:
        """Whose actor is a tanh-Gaussian."""

    @abc.abstractmethod
    def evaluate(
        self, policy: GaussianPolicy, episodes: int, seed: int, contact_margins: ContactMargins | None
    ) -> dict[str, Any]:
        """Figures of a policy for a line of the learning curve, "episodes" among them."""

    @abc.abstractmethod
    def in_words(self, line: dict[str, Any]) -> str:
        """A line of the curve in a few words."""

    def spec(self) -> Spec:
        """What the learner is told."""
        low, high = (-1.0,) * self.act_dim, (1.0,) * self.act_dim
        return Spec(self.obs_dim, self.act_dim, low, high, -np.inf, np.inf, self.terminates, self.time_limit)
