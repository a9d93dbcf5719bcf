"""Signs that a log cannot teach what is asked, from a bounded sample of its episodes."""

from dataclasses import dataclass

from odaf.data.checks.findings import Finding
from odaf.data.checks.sample import Sample
from odaf.data.checks.signs import conflicts, copied_actions, copied_rewards, effects, lonely_episodes
from odaf.data.checks.signs.conflicts import Conflict
from odaf.data.checks.signs.copied_actions import CopiedAction
from odaf.data.checks.signs.copied_rewards import CopiedReward
from odaf.data.checks.signs.effects import Effects
from odaf.data.checks.signs.lonely_episodes import LonelyEpisodes

__all__ = ["Conflict", "CopiedAction", "CopiedReward", "Effects", "LonelyEpisodes", "Signs", "find"]


@dataclass(frozen=True)
class Signs:
    """What was found, with what a picture of it needs.

    Attributes:
        copied_actions: columns that hold an action.
        copied_reward: a column that says the reward.
        effects: what actions change; None where there are too few rows.
        conflict: episodes that answer the same states differently.
        lonely: episodes that go where no other does.
    """

    copied_actions: tuple[CopiedAction, ...] = ()
    copied_reward: CopiedReward | None = None
    effects: Effects | None = None
    conflict: Conflict | None = None
    lonely: LonelyEpisodes | None = None

    def findings(self, names: tuple[str, ...], actions: tuple[str, ...]) -> list[Finding]:
        """For columns and actions of these names."""
        found = [entry.finding(names, actions) for entry in self.copied_actions]
        if self.copied_reward is not None:
            found.append(self.copied_reward.finding(names, actions))
        if self.effects is not None:
            found += self.effects.findings(actions)
        found += [sign.finding(names, actions) for sign in (self.conflict, self.lonely) if sign is not None]
        return found


def find(sample: Sample) -> Signs:
    """Everything that the sample shows."""
    copied = copied_actions.find(sample)
    return Signs(
        tuple(copied),
        copied_rewards.find(sample),
        effects.find(sample, copied),
        conflicts.find(sample),
        lonely_episodes.find(sample),
    )
