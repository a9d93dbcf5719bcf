"""A log as estimators see it, before they see a policy: in normalised units, by step, and resampled by episode."""

from collections.abc import Callable

import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.fitting import Batch, Progress, of_rows
from odaf.components.policies import Actor
from odaf.data.dataset import Dataset
from odaf.data.normalisation import Normaliser, scale_actions
from odaf.estimation.density import HOLDOUT, BehaviourDensity, fit_density
from odaf.estimation.fitted_q import Transitions
from odaf.estimation.recorded import Recorded, resampled, resampled_rows, rows_within
from odaf.estimation.settings import EstimateSettings


class Evidence:
    """A log in its own normalised units, and what whoever wrote it earned.

    Args:
        dataset: the log.
        horizon: steps of an episode that are counted.
        discounts: weights of a reward one step later, one for each valuation.
        settings: sizes of what is fitted.
        key: for resampled episodes.
    """

    def __init__(
        self,
        dataset: Dataset,
        horizon: int,
        discounts: tuple[float, ...],
        settings: EstimateSettings,
        key: PRNGKeyArray,
    ) -> None:
        self.dataset, self.settings, self.discounts, self.horizon = dataset, settings, discounts, horizon
        self.normaliser = Normaliser.fit(dataset.observations)
        self.observations = np.asarray(self.normaliser.normalise(dataset.observations), np.float32)
        self.next_observations = np.asarray(self.normaliser.normalise(dataset.next_observations), np.float32)
        low, high = (tuple(bound.tolist()) for bound in (dataset.action_low, dataset.action_high))
        scaled = scale_actions(dataset.actions, low, high)
        self.actions = np.clip(np.asarray(scaled, np.float32), -1.0, 1.0)
        self.episode = np.repeat(np.arange(dataset.num_episodes), dataset.episode_lengths())
        self.recorded = tuple(Recorded.of(dataset, horizon, discount) for discount in discounts)
        self.within = rows_within(dataset, horizon)
        rng = np.random.default_rng(np.asarray(jr.bits(key, (4,))))
        self.counts = resampled(dataset.num_episodes, settings.resamples, rng)
        self.held_out = np.zeros(0, np.int64)  # rows
        learnt = np.arange(len(dataset))
        if settings.early_stopping:
            order = rng.permutation(dataset.num_episodes)
            aside = np.isin(self.episode, order[: max(round(HOLDOUT * dataset.num_episodes), 1)])
            self.held_out, learnt = np.flatnonzero(aside), np.flatnonzero(~aside)
        table, self.member_counts = resampled_rows(self.episode[learnt], dataset.num_episodes, settings.members, rng)
        self.member_rows = learnt[table]
        self.own = [recorded.values(self.counts) for recorded in self.recorded]

    @property
    def starts(self) -> np.ndarray:
        """Rows where episodes begin."""
        return np.asarray(self.dataset.episode_starts)

    @property
    def half_ranges(self) -> np.ndarray:
        """Half the range of each action, in the log's units."""
        return (np.asarray(self.dataset.action_high, np.float64) - self.dataset.action_low) / 2.0

    def rows(self) -> Transitions:
        """What Q is fitted to."""
        return Transitions(
            self.observations,
            self.actions,
            self.dataset.rewards.astype(np.float64),
            self.dataset.terminated,
            self.next_observations,
        )

    def own_of_members(self, place: int) -> np.ndarray:
        """What the log earned at the discount of this place: [1 + members], as it is, then by member."""
        whole = np.concatenate([np.ones((1, self.dataset.num_episodes)), self.member_counts])
        return self.recorded[place].values(whole)[0]

    def fitted_density(self, key: PRNGKeyArray, progress: Progress) -> BehaviourDensity:
        """Of whoever acted."""
        return fit_density(
            self.observations,
            self.actions,
            self.episode,
            key,
            progress=progress,
            patience=self.settings.patience,
            **self.settings.fitting(),
        )

    def following_actions(self, density: BehaviourDensity, key: PRNGKeyArray) -> np.ndarray:
        """[rows, act_dim], the action that was logged next; where a recording was cut, a draw from the density."""
        following = np.concatenate([self.actions[1:], self.actions[-1:]])
        last = np.append(self.starts[1:], len(self.dataset)) - 1
        cut = last[~self.dataset.terminated[last]]
        if len(cut):
            columns = (jnp.asarray(self.next_observations[cut]), jnp.arange(len(cut)))
            following[cut] = of_rows(draws, (density.model, key), columns)
        return following


def modes(actor: Actor, batch: Batch) -> Float[Array, "rows act_dim"]:
    """For `of_rows`: the actions of a deployed policy."""
    return actor.mode(batch[0])


def draws(model: tuple[Actor, PRNGKeyArray], batch: Batch) -> Float[Array, "rows act_dim"]:
    """For `of_rows`: actions drawn from a policy; the second column numbers the rows."""
    actor, key = model
    observations, rows = batch
    return actor.act(actor.begin(observations.shape[0]), observations, jr.fold_in(key, rows[0]))[0]


class Stages:
    """Several fits as one progress."""

    def __init__(self, progress: Progress, steps: int, stages: int) -> None:
        self.progress, self.steps, self.stages, self.done = progress, steps, stages, 0

    def next(self) -> Callable[[int, int], None]:
        """The progress of the next fit."""
        before, self.done = self.done * self.steps, self.done + 1
        return lambda done, total: self.progress(before + done * self.steps // total, self.stages * self.steps)

    def finished(self) -> None:
        """All is done, though a fit may have stopped early."""
        self.progress(self.stages * self.steps, self.stages * self.steps)
