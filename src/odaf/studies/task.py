"""What a study asks policies to learn: a log, how they are tried, and how a score is read."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from odaf.studies.ant_maze_logs import AntMazeLog
from odaf.studies.logs import MazeLog, MixedLog, RecordedLog
from odaf.studies.public_logs import PublicLog, PublicMixture


@dataclass(frozen=True)
class Evaluation:
    """How policies are tried.

    Attributes:
        every: updates between two evaluations while a policy trains; the last update is evaluated too.
        episodes: in each of them.
        final_episodes: played again at the last checkpoint; None takes the last of the evaluations as it is.
    """

    every: int = 5_000
    episodes: int = 50
    final_episodes: int | None = None


@dataclass(frozen=True)
class Task:
    """What is to be learned.

    Attributes:
        log: the data.
        evaluation: how policies are tried, in the environment that the log names.
        score: the figure of an evaluation that tables read: "mean_return", the raw return; "normalised_score", 0 for a
            random policy and 100 for an expert; or a rate that the environment reports, as "stitched_rate".
        field: what records call it.
        common: settings that all learners of this task share, by dotted name.
        version: raised when the same log and evaluation would give other scores. Older records have 1.
    """

    log: MazeLog | AntMazeLog | MixedLog | RecordedLog | PublicLog | PublicMixture
    evaluation: Evaluation
    score: str = "mean_return"
    field: str = "task"
    common: tuple[tuple[str, Any], ...] = ()
    version: int = 1

    @property
    def name(self) -> str:
        """That of its log."""
        return self.log.name

    def read(self, evaluation: Mapping[str, Any]) -> float:
        """The score of an evaluation, such as a record's "final"."""
        return float(evaluation[self.score])

    def settings(self) -> dict[str, Any]:
        """What of it decides scores, the log apart."""
        every, episodes, final = self.evaluation.every, self.evaluation.episodes, self.evaluation.final_episodes
        return {"version": self.version, "every": every, "episodes": episodes, "final_episodes": final or episodes}
