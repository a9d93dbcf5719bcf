"""Which states a policy is predicted to come to, whether the log knows them, and what may happen where it does not.

    x = W s,     d(s) = min_m | x - x_m |,     W^T W = ( C + e I )^-1

s is a state in the log's normalised units, C the covariance of the logged ones, x_m logged states. The policy's are
those of rollouts in the fitted model. One of them is *unlike* the log's where it lies farther from them than all but a
hundredth of the states of one logged episode lie from those of others.

It is outcomes that must be known, not actions: where operators hold an action for minutes every other one is rare, and
still may lead to states that the log knows well; and a policy that takes usual actions at wrong moments leaves it. But
where no one ever acted so, nothing tells what an action leads to, and a model that sees it lead home only goes on as it
learnt to: a step is unlike, too, if an action lies beyond all logged ones by more than a twentieth of their range. What
an unlike state earns is taken for unknown, between what episodes of the log earn a step (its quantiles) and nothing, if
the episode should end there:

    below = E sum_t gamma^t S_t 1[ t unlike ] ( r_t - low )^+       by so much less may an episode be worth,
    above = E sum_t gamma^t S_t 1[ t unlike ] ( high - r_t )^+      and by so much more

r_t and S_t, the share of episodes that still run, are the model's. The range that the data leave open takes the place
of a guess, as in Manski (1990).
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from odaf.estimation.density import RARE
from odaf.estimation.evidence import Evidence

SPREAD_FLOOR = 1e-2  # e: in directions of less variance than this, distances do not grow any more
ROWS = 10_000  # of the log at most, that states are compared with
STATES = 4_000  # at most, that are compared
FOLDS = 5  # of episodes: each is compared with the others
MARGIN, ROUNDING = 0.05, 1e-3  # an action may lie so far beyond the logged ones: of their range, and in any case


@dataclass(frozen=True, eq=False)
class Visited:
    """Steps of episodes that were played in a model.

    Attributes:
        states: [steps, episodes, obs_dim], which each step led to, normalised.
        running: [steps, episodes], share of the episode that still runs when the step is taken.
        rewards: [steps, episodes], expected of the step, in the log's unit.
        actions: [steps, episodes, act_dim] of each step, in [-1, 1].
    """

    states: np.ndarray
    running: np.ndarray
    rewards: np.ndarray
    actions: np.ndarray


@dataclass(frozen=True)
class Unknown:
    """What the log leaves open about a policy, at one discount.

    Attributes:
        share: of its steps, those that lead to states unlike the log's, or take actions beyond all of its.
        below: how much less an episode may be worth than the model says, in the log's unit of reward.
        above: how much more.
        low: the least that an unlike state is taken to earn.
        high: the most.
    """

    share: float
    below: float
    above: float
    low: float
    high: float


class KnownOutcomes:
    """States that a log knows, and what its episodes earn a step."""

    def __init__(self, log: Evidence) -> None:
        rows = log.observations.astype(np.float64)
        covariance = np.cov(rows, rowvar=False).reshape(rows.shape[1], rows.shape[1])
        values, vectors = np.linalg.eigh(covariance)
        self._whitening = (vectors / np.sqrt(np.maximum(values, 0.0) + SPREAD_FLOOR)) @ vectors.T
        self._discounts = log.discounts
        rng = np.random.default_rng(0)
        kept, asked = (rng.permutation(len(rows))[:most] for most in (ROWS, STATES))
        fold = log.episode % FOLDS
        apart = np.zeros(len(asked))
        for number in np.unique(fold[asked]):
            here = fold[asked] == number
            tree = self._tree_of(rows[kept[fold[kept] != number]])
            apart[here] = self._distances(tree, log.next_observations[asked[here]])
        self.bound = float(np.quantile(apart, 1.0 - RARE))
        self._tree = self._tree_of(rows[kept])
        low, high = log.actions.min(axis=0), log.actions.max(axis=0)
        margin = np.maximum(MARGIN * (high - low), ROUNDING)
        self._actions = low - margin, high + margin
        lengths = log.dataset.episode_lengths()
        earned = np.add.reduceat(log.dataset.rewards.astype(np.float64), log.starts) / lengths
        tail = 0.5 * (1.0 - log.settings.confidence)
        low, high = np.quantile(earned, [tail, 1.0 - tail])
        self.low, self.high = min(float(low), 0.0), max(float(high), 0.0)

    def unlike(self, states: np.ndarray) -> np.ndarray:
        """[n] bool for states [n, obs_dim], normalised."""
        return self._distances(self._tree, states) > self.bound

    def beyond(self, actions: np.ndarray) -> np.ndarray:
        """[n] bool for actions [n, act_dim] in [-1, 1]: whether no one ever acted so."""
        (low, high), taken = self._actions, np.clip(actions, -1.0, 1.0)
        return np.any((taken < low) | (taken > high), axis=1)

    def unknown(self, visited: Visited) -> tuple[Unknown, ...]:
        """What the log leaves open about whoever came to these states, at each discount."""
        steps, episodes = visited.running.shape
        chosen = np.random.default_rng(0).permutation(steps * episodes)[:STATES]
        states, actions = (column.reshape(steps * episodes, -1)[chosen] for column in (visited.states, visited.actions))
        unlike = self.unlike(states) | self.beyond(actions)
        running, rewards = (column.ravel()[chosen].astype(np.float64) for column in (visited.running, visited.rewards))
        share = float(np.sum(running * unlike) / max(np.sum(running), 1e-12))
        found = []
        for discount in self._discounts:
            weights = steps / len(chosen) * discount ** (chosen // episodes) * running * unlike  # sums to an episode's
            below, above = (
                float(np.sum(weights * np.maximum(gap, 0.0))) for gap in (rewards - self.low, self.high - rewards)
            )
            found.append(Unknown(share, below, above, self.low, self.high))
        return tuple(found)

    def _tree_of(self, rows: np.ndarray) -> KDTree:
        return KDTree(rows @ self._whitening)

    def _distances(self, tree: KDTree, states: np.ndarray) -> np.ndarray:
        return np.asarray(tree.query(states.astype(np.float64) @ self._whitening)[0])
