"""How far each step lies from what the rest of the log makes foreseeable."""

from dataclasses import dataclass

import numpy as np

MOST_COLUMNS, MOST_ACTIONS = 32, 16
SMOOTH = 0.3
"""Columns whose usual step is more than this share of their range tell no step from a leap."""
FLOOR = 0.005
"""Steps below this share of a column's range are never large, however still the column usually is."""
LEAST, MOST = 0.5, 50.0
ROUNDS = 4
QUANTILE, KEPT = 0.75, 0.85
CLOCK = 0.01
"""Columns whose steps differ by less than this share are clocks: they say nothing of the plant."""


@dataclass(frozen=True)
class Surprise:
    """Measures steps against usual ones: raw, and as errors of a linear prediction from row, action and last step.

    A step counts by the smaller of the two: neither a far step that was foreseeable (the fast beginning of each
    episode) nor a small unforeseen one (a hit that turns a speed around) is a leap. Columns are joined by their
    geometric mean, so that one column that leaps alone (a clock at midnight, a new set point) makes none of all.

    Attributes:
        columns: observation columns that are looked at.
        low: [columns] what is subtracted from them.
        width: [columns] what they are divided by: from the 5th to the 95th percentile.
        action_size: [actions] what actions are divided by.
        weights: [1 + 2 columns + actions, columns] of the prediction of a step.
        usual_step: [columns] three quarters of the steps are smaller.
        usual_error: [columns] three quarters of the errors are smaller.
    """

    columns: np.ndarray
    low: np.ndarray
    width: np.ndarray
    action_size: np.ndarray
    weights: np.ndarray
    usual_step: np.ndarray
    usual_error: np.ndarray

    def scaled(self, observations: np.ndarray) -> np.ndarray:
        """[rows, columns] in units of each column's range."""
        return (observations[:, self.columns].astype(np.float64) - self.low) / self.width

    def of(self, before: np.ndarray, actions: np.ndarray, velocity: np.ndarray, after: np.ndarray) -> np.ndarray:
        """[rows] surprise of steps, about 1 where usual; all arguments but the actions `scaled`.

        Args:
            before: [rows, columns].
            actions: [rows, act_dim].
            velocity: [rows, columns] the step that led to `before`; 0 where an episode began.
            after: [rows, columns].
        """
        steps = after - before
        errors = steps - _features(before, actions, self.action_size, velocity) @ self.weights
        return np.minimum(_joined(steps, self.usual_step), _joined(errors, self.usual_error))

    def distance(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """[rows] how far one row lies from the other, about 1 where as far as a usual step; both `scaled`."""
        return _joined(after - before, self.usual_step)


def fit(observations: np.ndarray, actions: np.ndarray, goes_on: np.ndarray) -> Surprise | None:
    """What steps usually are in these rows; None where they are too few, or leap all the time.

    Steps that surprise most are left out when the prediction is fitted again: up to a tenth may be no steps at all.

    Args:
        observations: [rows, obs_dim].
        actions: [rows, act_dim].
        goes_on: [rows - 1] whether row i + 1 follows row i in an episode.
    """
    if np.count_nonzero(goes_on) < 100:
        return None
    values = observations.astype(np.float64)
    low, high = np.quantile(values, [0.05, 0.95], axis=0)
    with np.errstate(over="ignore", invalid="ignore"):
        steps = np.abs(np.diff(values, axis=0)[goes_on])
        moves = (steps > 0).any(axis=0) & np.isfinite(high - low)
        smooth = moves & (high > low) & (np.quantile(steps, QUANTILE, axis=0) < SMOOTH * (high - low))
    columns = np.flatnonzero(smooth & ~_clocks(values, goes_on) & np.isfinite(values).all(axis=0))
    if not len(columns):
        return None
    columns = columns[np.unique(np.linspace(0, len(columns) - 1, MOST_COLUMNS).astype(int))]
    low, width = low[columns], (high - low)[columns]
    scaled = (values[:, columns] - low) / width
    velocity = np.zeros_like(scaled[:-1])
    velocity[1:] = np.where(goes_on[:-1, None], np.diff(scaled[:-1], axis=0), 0.0)
    size = np.abs(actions[:, :MOST_ACTIONS].astype(np.float64)).max(axis=0, initial=0.0)
    size = np.where(np.isfinite(size) & (size > 0), size, 1.0)
    features = _features(scaled[:-1], actions[:-1], size, velocity)[goes_on]
    features = np.where(np.isfinite(features), features, 0.0)
    targets = np.diff(scaled, axis=0)[goes_on]
    usual_step = _usual(targets)
    weights, usual_error = np.zeros((features.shape[1], len(columns))), usual_step
    kept = np.ones(len(targets), bool)
    for _ in range(ROUNDS):
        chosen = features[kept]
        ridge = 1e-6 * len(chosen) * np.eye(features.shape[1])
        weights = np.linalg.solve(chosen.T @ chosen + ridge, chosen.T @ targets[kept])
        errors = targets - features @ weights
        usual_error = _usual(errors)
        surprise = _joined(errors, usual_error)
        kept = surprise <= np.quantile(surprise, KEPT)
    return Surprise(columns, low, width, size, weights, usual_step, usual_error)


def _features(before: np.ndarray, actions: np.ndarray, size: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    return np.concatenate([np.ones((len(before), 1)), before, actions[:, :MOST_ACTIONS] / size, velocity], axis=1)


def _usual(steps: np.ndarray) -> np.ndarray:
    """[columns] what three quarters of the steps stay below, or half of those that move at all, or half of nine tenths:
    also where a sensor has few digits, or a plant is at rest most of the time."""
    size = np.abs(steps)
    most, nearly_all = np.quantile(size, [QUANTILE, 0.9], axis=0)
    moving = np.array([np.median(column[column > 0]) if (column > 0).any() else 0.0 for column in size.T])
    return np.maximum.reduce([most, nearly_all / 2, moving, np.full_like(most, FLOOR)])


def _clocks(values: np.ndarray, goes_on: np.ndarray) -> np.ndarray:
    """[obs_dim] whether a column counts time."""
    with np.errstate(over="ignore", invalid="ignore"):
        low, middle, high = np.quantile(np.diff(values, axis=0)[goes_on], [0.1, 0.5, 0.9], axis=0)
        return high - low <= CLOCK * np.abs(middle)


def _joined(steps: np.ndarray, usual: np.ndarray) -> np.ndarray:
    return np.exp(np.log(np.clip(np.abs(steps) / usual, LEAST, MOST)).mean(axis=1))
