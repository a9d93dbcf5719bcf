"""What of a log a learner sees: one description, made by the learner, that columns are built from in one place."""

from dataclasses import dataclass
from typing import Literal

from odaf.data.row_choice import UNIFORM, RowChoice
from odaf.errors import ConfigError

Extra = Literal["next_actions", "followed", "successor_known", "returns_to_go", "episode_steps"]


@dataclass(frozen=True)
class View:
    """How the rows of a log are shown to a learner.

    Attributes:
        return_steps: n. A row spans n steps: its reward is the discounted sum of the n rewards from it on, its
            successor the state n steps later.
        discount: weight of a reward one step later, in [0, 1); None for a learner that has no use for later rewards.
        reward_scale: factor on every logged reward, after the shift.
        reward_shift: added to every logged reward, such as -1 in mazes whose reward is 1 at the goal.
        normaliser_epsilon: added to the standard deviations that observations are divided by, in the user's units.
        extras: further columns, in `Transitions.extras` by name:
            `next_actions` [act_dim], scaled to [-1, 1]: the action logged at the successor, zero where none was;
            `followed`: 1.0 where that action was logged, 0.0 at an episode's last row;
            `successor_known`: 0.0 where a true end repeats its own state as a placeholder, else 1.0;
            `returns_to_go`: discounted sum of the scaled rewards from this row on, see `odaf.data.returns_to_go`;
            `episode_steps`: the row's number in its episode, from 0.
        choice: which of these rows batches are drawn from, and how often.
    """

    return_steps: int = 1
    discount: float | None = None
    reward_scale: float = 1.0
    reward_shift: float = 0.0
    normaliser_epsilon: float = 0.0
    extras: tuple[Extra, ...] = ()
    choice: RowChoice = UNIFORM

    def __post_init__(self) -> None:
        if self.return_steps < 1:
            raise ConfigError(f"return_steps={self.return_steps} must be at least 1")
        if self.discount is None and (self.return_steps > 1 or "returns_to_go" in self.extras):
            raise ConfigError("view: return_steps above 1 and returns_to_go sum rewards, so they need a discount")
