"""E4 with a trap: a cell beside the path that the log never entered, and of which the learner believes the best."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from odaf.theory.candidates import action_supported, outcome_supported
from odaf.theory.experiments.experiment import Check, Experiment, Findings, verdict
from odaf.theory.gridworld import Cell, Grid, logged_moves, snake, start_value, walk
from odaf.theory.mdp import policy_values
from odaf.theory.operator import fixed_point, greedy, state_values

MAP = ("S....#", ".....#", ".....X", ".....#", "....G#")


@dataclass(frozen=True)
class Trap(Experiment):
    """The grid of E4 with one more cell, east of its middle row; whoever enters it stays and gets nothing.

    Attributes:
        believed: reward that the learner expects of entering it, as values of unseen outcomes are often too high.
        discount: gamma.
    """

    believed: float = 1.0
    discount: float = 0.9

    label: ClassVar[str] = "E4"
    name: ClassVar[str] = "trap"
    corrected: ClassVar[str] = (
        "Where some action stays in the data, neither set has one that leaves them, whatever is believed of the cells "
        "there; the outcome-driven set still holds the shortest path, which passes the trap."
    )
    printed: ClassVar[str] = (
        "No statement of the paper's; its claim of stitching without unseen outcomes, in the small."
    )

    def measure(self) -> Findings:
        grid = Grid(MAP)
        believed, true = grid.mdp(self.discount, self.believed), grid.mdp(self.discount)
        logged, visited = logged_moves(grid, snake(5, 5))
        sets = {
            "action": action_supported(logged, believed.transitions, visited),
            "outcome": outcome_supported(believed.transitions, visited),
            "every action": np.ones_like(logged),
        }
        trap, paths, promised, earned = grid.state("X"), dict[str, list[Cell]](), {}, {}
        for name, allowed in sets.items():
            q = fixed_point(believed, allowed)
            policy = greedy(q, allowed)
            paths[name] = walk(grid, policy)
            promised[name] = start_value(grid, state_values(q, allowed))
            earned[name] = start_value(grid, policy_values(true, policy))
        entries = {
            name: int((allowed[visited] & (grid.successors()[visited] == trap)).sum()) for name, allowed in sets.items()
        }
        moves = {name: len(path) - 1 for name, path in paths.items()}
        entered = grid.sign(paths["every action"][-1]) == "X"
        kept = max(abs(earned[name] - promised[name]) for name in ("action", "outcome"))
        return Findings(
            (
                *(
                    Check(
                        "corrected",
                        f"actions of the {name}-supported set that enter the trap from the data",
                        entries[name],
                        "0",
                        verdict(entries[name] == 0),
                    )
                    for name in ("action", "outcome")
                ),
                Check(
                    "corrected",
                    "moves to the goal by outcomes in the data",
                    moves["outcome"],
                    "8, the shortest path",
                    verdict(moves["outcome"] == 8 and grid.sign(paths["outcome"][-1]) == "G"),
                ),
                Check(
                    "corrected",
                    "largest difference of promised and true value at the start, both sets",
                    kept,
                    "< 1e-8",
                    verdict(kept < 1e-8),
                ),
                Check(
                    "corrected",
                    "control: the operator over every action enters the trap, and earns",
                    earned["every action"],
                    f"0, promised {promised['every action']:.2f}",
                    verdict(entered and earned["every action"] == 0.0),
                ),
            ),
            {"cells": len(grid.cells)},
            {
                "map": list(grid.rows),
                "paths": {name: [list(cell) for cell in path] for name, path in paths.items()},
                "promised": promised,
                "earned": earned,
                "entries_of_every_action": entries["every action"],
            },
        )
