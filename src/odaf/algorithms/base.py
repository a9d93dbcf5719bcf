"""The contract between a learner and the loop that trains it."""

import abc
import dataclasses
from collections.abc import Callable, Hashable
from typing import Any, ClassVar, Generic, TypeVar

import equinox as eqx
from jaxtyping import Array, Float, Int, PRNGKeyArray, PyTree

from odaf.algorithms.citations import Citation
from odaf.components.critics import CriticEnsemble
from odaf.components.policies import Actor
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser, ObservationScaling
from odaf.data.row_choice import RowChoice
from odaf.data.sampling import Columns, sample
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.data.view import View
from odaf.errors import ConfigError

Metrics = dict[str, Float[Array, ""]]
PretrainProgress = Callable[[str, int, int], None]


class LearnerState(eqx.Module):
    """Everything that changes while a learner trains; a pytree of arrays."""

    step: eqx.AbstractVar[Int[Array, ""]]


State = TypeVar("State", bound=LearnerState)


@dataclasses.dataclass(frozen=True, kw_only=True)
class CommonSettings(RowChoice, ObservationScaling):
    """What every learner can be told: which rows batches hold, how observations are scaled, and what is deployed."""

    averaged_updates: int = 0
    """H, over about how many of its last updates the deployed policy averages the actor's parameters, for a policy that
    does not swing with each; 0 deploys the actor itself. The learner does not see the average."""


class Algorithm(CommonSettings, abc.ABC, Generic[State]):
    """A learner's settings (a frozen dataclass, those of `CommonSettings` among them) and its pure functions.

    The loop calls, in this order: `normaliser`, `view`, `pretrain`, `init`, then `refresh`, `batch` and `update` inside
    compiled stretches, and `actor` for evaluation. Observations are normalised and actions scaled to [-1, 1] everywhere
    in here.

    Settings that are floating-point numbers other than 0 are traced: inside compiled code they are arrays, so that
    learners that differ in them alone share one program. A number that is exactly 0 switches its part off and is part
    of the structure; ask with `odaf.algorithms.numbers.is_off`. Fields named in `structural` stay what they are.
    """

    kind: ClassVar[str]
    structural: ClassVar[frozenset[str]] = frozenset()
    draws_apart: ClassVar[bool] = False
    """Whether `update` trains the actor on `batch.for_actor` and all else on `batch`, which critic_sampling needs."""
    warm_up: ClassVar[str | None] = None
    """The setting that holds how many updates at the start let the actor only fit the log; None where none do."""
    refresh_every: int = 0
    """Updates between two calls of `refresh`, the first one before the first update; 0 never calls it."""
    batch_size: int

    def can_be_padded(self) -> bool:
        """Whether a lane may have more columns than its data set, so that robots of different widths share a program.

        Then updates leave zero weights of columns that a batch does not own at zero and do not count these columns:
        noise is the batch's `action_noise`, means its `mean_over_actions`, densities are of its `own_actions`. A
        network's inputs are observations, actions, or observations and then actions, its outputs actions or two sets of
        them. Say so of a class and not of those that are derived from it.
        """
        return False

    def citations(self) -> tuple[Citation, ...]:
        """The papers to name beside results of these settings; those of its terms come from the terms."""
        return ()

    def view(self) -> View:
        """What of the log the learner sees; by default single rows with the reward as logged."""
        return View()

    def drawn_view(self) -> View:
        """`view`, and how its rows are drawn: what the columns that batches come from are built by.

        Raises:
            ConfigError: a setting is out of its range, or critics are to draw apart in a learner that cannot do it.
        """
        choice = self.row_choice()
        if choice.critic_sampling == "uniform" and not self.draws_apart:
            raise ConfigError(
                f"critic_sampling='uniform': {self.kind} learns all it learns from one batch; take "
                "critic_sampling='same', or a learner whose critics can draw apart, such as td3-bc or iql"
            )
        return dataclasses.replace(self.view(), choice=choice)

    def normaliser(self, dataset: Dataset) -> Normaliser:
        """How observations are scaled for this log.

        Raises:
            ConfigError: observation_scaling is not known.
        """
        return self.normaliser_of(dataset.observations, self.view().normaliser_epsilon)

    def sizes(self, spec: Spec) -> tuple[int, ...]:
        """Whatever of a data set, its widths apart, decides shapes of the state; lanes of one program agree in it."""
        del spec
        return ()

    def untrained(self, key: PRNGKeyArray, spec: Spec) -> PyTree:
        """Models before pre-training, in the structure that `pretrain` returns; () when there are none."""
        del key, spec
        return ()

    def pretrain(
        self, dataset: Dataset, normaliser: Normaliser, key: PRNGKeyArray, progress: PretrainProgress
    ) -> tuple[PyTree, dict[str, Any]]:
        """Train the models that the learner needs beforehand on the log; by default there are none.

        Args:
            dataset: the log, in the user's units.
            normaliser: the observation scaling that training will use.
            key: random key.
            progress: called with (stage, steps done, steps in all).

        Returns:
            The models and a JSON-able report, whose entry "warnings" lists sentences for the user.
        """
        del dataset, normaliser, key, progress
        return (), {"warnings": []}

    def pretraining(self) -> Hashable:
        """The settings that decide what `pretrain` gives for a log, its scaling and a key; () where nothing is trained.

        Lanes that agree in all of it share the models. By default it is the whole learner, so that lanes of other
        settings share none.
        """
        return () if type(self).pretrain is Algorithm.pretrain else self

    @abc.abstractmethod
    def init(self, key: PRNGKeyArray, spec: Spec, models: PyTree) -> State:
        """State at step 0 around the models of `pretrain`."""

    def refresh(self, state: State, columns: Columns, key: PRNGKeyArray) -> State:
        """What happens before every `refresh_every`-th update, such as rolling a model out into a buffer of the state.

        Pure and traceable. It happens by the number of the update, so where a run is cut changes no bit of it.

        Args:
            state: after a multiple of `refresh_every` updates, 0 included.
            columns: what batches are drawn from.
            key: random key of this refresh alone.
        """
        del columns, key
        return state

    def batch(self, state: State, columns: Columns, key: PRNGKeyArray) -> Transitions:
        """The rows of one update; by default `batch_size` rows, drawn as the settings say."""
        del state
        return sample(columns, key, self.batch_size)

    @abc.abstractmethod
    def update(self, state: State, batch: Transitions, key: PRNGKeyArray) -> tuple[State, Metrics]:
        """One gradient step on one batch. Pure and traceable; metric names are the same at every step."""

    @abc.abstractmethod
    def actor(self, state: State) -> Actor:
        """What the trained policy is: all that is needed to act, and nothing else. May be traced."""

    def values(self, state: State) -> CriticEnsemble | None:
        """Q_k(s, a) of the rewards that the learner trains on, for attacks and guards; None without critics.

        May be traced.
        """
        del state
        return None
