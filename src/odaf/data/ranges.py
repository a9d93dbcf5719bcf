"""What a log has shown of its columns: the ranges they moved in, and how fast actions changed."""

from typing import Any

import numpy as np

from odaf.data.rows import Rows


def ranges(dataset: Rows) -> dict[str, Any]:
    """In the user's units, in JSON types, an entry a column.

    Returns:
        `observation_low`, `observation_high`, `action_low`, `action_high`: smallest and largest logged value.
        `largest_action_change`: largest absolute change of each action from one row of an episode to the next; 0 where
        no episode has two rows.
        `time_step`: usual time between rows in the unit of the log's time column; None where the log has none.
    """
    changes = []
    inside = np.ones(max(len(dataset) - 1, 0), bool)
    inside[dataset.episode_starts[1:] - 1] = False
    for column in dataset.actions.T:  # one at a time: the rows may be many
        steps = np.abs(np.diff(column))[inside]
        changes.append(float(steps.max()) if len(steps) else 0.0)
    step = dataset.provenance.get("time_step")
    return {
        "observation_low": dataset.observations.min(axis=0).tolist(),
        "observation_high": dataset.observations.max(axis=0).tolist(),
        "action_low": dataset.actions.min(axis=0).tolist(),
        "action_high": dataset.actions.max(axis=0).tolist(),
        "largest_action_change": changes,
        "time_step": float(step) if isinstance(step, int | float) else None,
    }
