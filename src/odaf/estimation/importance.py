"""Importance sampling: logged episodes, weighed by how much more probable the policy makes their actions.

    w_et = prod_{k <= t} pi(a_ek | s_ek) / b(a_ek | s_ek)

    weighted        V = sum_e w_e G_e / sum_e w_e, with w_e of the episode's last row and G_e its return
    per decision    as `odaf.estimation.recorded` says, with these weights
    doubly robust   V = sum_t gamma^t sum_e [ u_et ( r_et - Q(s_et, a_et) ) + u_e,t-1 V(s_et) ],
                    u_et = w_et / sum_e w_et,  u_e,-1 = 1 / E

(Precup et al. 2000; weighted doubly robust: Thomas and Brunskill 2016.) All are self-normalised, so weights may be
multiplied by any constant of the step. An episode that is over keeps its last weight. Q and V are of the steps that are
left to the horizon; V of the state at which a recording was cut stands for what was not recorded. The effective number
of episodes is (sum_e w_e)^2 / sum_e w_e^2.
"""

from dataclasses import dataclass

import numpy as np

from odaf.estimation.recorded import Recorded


@dataclass(frozen=True, eq=False)
class Weights:
    """Weights of a log's rows, each step's largest 1.

    Attributes:
        by_step: [E, H]; an episode that is over keeps its last one.
        recorded: the log.
    """

    by_step: np.ndarray
    recorded: Recorded

    @classmethod
    def of(cls, recorded: Recorded, log_ratios: np.ndarray) -> "Weights":
        """From log pi(a|s) - log b(a|s), [E, H]; entries without a row are 0."""
        summed = np.cumsum(log_ratios * recorded.present, axis=1)
        return cls(np.exp(summed - summed.max(axis=0, keepdims=True)), recorded)

    @property
    def effective_episodes(self) -> float:
        """Of whole episodes, up to the horizon."""
        last = self.by_step[:, -1]
        return float(np.sum(last) ** 2 / np.sum(np.square(last)))

    def per_decision(self, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Value and length of an episode, [resamples] each."""
        return self.recorded.values(counts, self.by_step)

    def whole_episodes(self, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The same of episodes that are complete, by the weights of their last rows.

        NaN where a resample holds none of them.
        """
        weighed = counts * (self.by_step[:, -1] * self.recorded.complete)
        sums = weighed.sum(axis=1)
        discounts = self.recorded.discounts
        with np.errstate(divide="ignore", invalid="ignore"):
            value, length = (
                (weighed @ (column @ discounts)) / sums for column in (self.recorded.rewards, self.recorded.present)
            )
        return value, length

    def doubly_robust(
        self, counts: np.ndarray, rewards: np.ndarray, action_values: np.ndarray, state_values: np.ndarray
    ) -> np.ndarray:
        """Value of an episode, [resamples].

        Args:
            counts: [resamples, E].
            rewards: [E, H]; 1 in every row gives the length of an episode.
            action_values: [E, H], Q of the logged actions; 0 without a row.
            state_values: [E, H + 1], V of the logged states and of the state at which a recording was cut, else 0.
        """
        sums = counts @ self.by_step
        before = np.concatenate([np.ones((len(self.by_step), 1)), self.by_step], axis=1)
        sums_before = counts @ before
        discounts = np.append(self.recorded.discounts, self.recorded.discount**self.recorded.horizon)
        with np.errstate(divide="ignore", invalid="ignore"):
            corrections = (counts @ (self.by_step * (rewards - action_values))) / sums
            states = (counts @ (before * state_values)) / sums_before
        return np.nan_to_num(corrections) @ discounts[:-1] + np.nan_to_num(states) @ discounts
