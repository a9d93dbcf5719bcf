"""E4: what the outcome-driven set allows beyond the action-supported one, on a grid with one logged path."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from odaf.theory.candidates import action_supported, outcome_supported
from odaf.theory.experiments.experiment import Check, Experiment, Findings, verdict
from odaf.theory.gridworld import Grid, logged_moves, snake, start_value, walk
from odaf.theory.mdp import random_mdp, random_support
from odaf.theory.operator import fixed_point, greedy, state_values


@dataclass(frozen=True)
class Flexibility(Experiment):
    """A square grid whose log is one path through every cell, and random problems with logged admissible actions.

    Attributes:
        seed: of everything drawn.
        size: rows and columns, odd, so that the path ends in the corner opposite its start.
        problems: random problems.
        share: of states in the data of these.
        discount: gamma.
    """

    seed: int = 7
    size: int = 5
    problems: int = 100
    share: float = 0.8
    discount: float = 0.9

    label: ClassVar[str] = "E4"
    name: ClassVar[str] = "flexibility"
    corrected: ClassVar[str] = (
        "Where the outcomes of logged actions are in the data, Pi_ac is within Pi, so V_outcome >= V_action in every "
        "state; on the grid the path from the start is as short as the cells allow, and the start is worth more."
    )
    printed: ClassVar[str] = (
        "The paper says so in words and proves nothing of it; it does not say that Pi must be known, that is, where "
        "actions lead that nobody took."
    )

    def measure(self) -> Findings:
        edge = "." * (self.size - 1)
        grid = Grid(("S" + edge, *["." * self.size] * (self.size - 2), edge + "G"))
        mdp, logged_path = grid.mdp(self.discount), snake(self.size, self.size)
        logged, visited = logged_moves(grid, logged_path)
        sets = {
            "action": action_supported(logged, mdp.transitions, visited),
            "outcome": outcome_supported(mdp.transitions, visited),
        }
        q = {name: fixed_point(mdp, allowed) for name, allowed in sets.items()}
        values = {name: state_values(q[name], sets[name]) for name in sets}
        paths = {name: walk(grid, greedy(q[name], sets[name])) for name in sets}
        moves = {name: len(path) - 1 for name, path in paths.items()}
        gain = values["outcome"] - values["action"]
        at_start = start_value(grid, gain)
        lowest, cells = min(float(gain.min()), self._random_gain()), self.size**2
        shortest = 2 * (self.size - 1)
        return Findings(
            (
                Check(
                    "corrected",
                    "moves to the goal by logged actions",
                    moves["action"],
                    f"{cells - 1}, the logged path",
                    verdict(moves["action"] == cells - 1),
                ),
                Check(
                    "corrected",
                    "moves to the goal by outcomes in the data",
                    moves["outcome"],
                    f"{shortest}, the shortest path",
                    verdict(moves["outcome"] == shortest),
                ),
                Check(
                    "corrected",
                    "smallest V_outcome - V_action, cells and random problems",
                    lowest,
                    ">= -1e-8",
                    verdict(lowest >= -1e-8),
                ),
                Check("corrected", "V_outcome - V_action at the start", at_start, "> 0.1", verdict(at_start > 0.1)),
            ),
            {"cells": cells, "problems": self.problems},
            {
                "map": list(grid.rows),
                "logged": [list(cell) for cell in logged_path],
                "paths": {name: [list(cell) for cell in path] for name, path in paths.items()},
                "start_values": {name: start_value(grid, value) for name, value in values.items()},
            },
        )

    def _random_gain(self) -> float:
        """The smallest V_outcome - V_action where some of the admissible actions are the logged ones."""
        rng, found = np.random.default_rng(self.seed), []
        for _ in range(self.problems):
            mdp = random_mdp(rng, discount=self.discount)
            support = random_support(rng, len(mdp.rewards), self.share)
            outcome = outcome_supported(mdp.transitions, support)
            logged = outcome & (rng.uniform(size=outcome.shape) < 0.5)
            action = action_supported(logged, mdp.transitions, support)
            values = [state_values(fixed_point(mdp, allowed), allowed) for allowed in (outcome, action)]
            found.append((values[0] - values[1]).min())
        return float(min(found))
