"""A run as its user holds it: policies, scores and curves of a directory that training wrote."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odaf.evaluation.scores import Scores, scores_from
from odaf.training.checkpoints import Checkpoint
from odaf.training.policy import Policy
from odaf.training.run_directory import RunDirectory

if TYPE_CHECKING:
    import polars


@dataclass(frozen=True)
class Run:
    """A run, finished or not; needs nothing but its directory, least of all the dataset."""

    files: RunDirectory

    @property
    def directory(self) -> Path:
        """Where the run lies, as it was given."""
        return self.files.path

    @property
    def seeds(self) -> tuple[int, ...]:
        """The training seeds."""
        return self.files.seeds

    @property
    def config(self) -> dict[str, Any]:
        """Every resolved setting."""
        return self.files.config

    @property
    def data(self) -> dict[str, Any]:
        """Where the training data came from, their sizes, normaliser and environment."""
        return self.files.data

    @property
    def summary(self) -> dict[int, dict[str, Any]]:
        """The state of affairs at each seed's last checkpoint."""
        return {seed: self.files.summary(seed) for seed in self.seeds}

    def policy(self, seed: int | None = None, step: int | None = None) -> Policy:
        """What a seed (None: the first) had learned after `step` updates (None: at its last checkpoint)."""
        return self.files.policy(self.seeds[0] if seed is None else seed, step)

    def scores(self) -> Scores:
        """Last-checkpoint scores of every seed.

        Raises:
            CheckpointError: a seed was not evaluated.
        """
        environment = self.files.evaluation_environment or {}
        return scores_from(self.summary, str(self.directory), environment.get("id"))

    def checkpoints(self, seed: int | None = None) -> list[Checkpoint]:
        """A seed's checkpoints, earliest first."""
        return self.files.checkpoints(self.seeds[0] if seed is None else seed)

    def metrics(self, seed: int | None = None) -> "polars.DataFrame":
        """What was logged, as a table with one row a seed and step.

        Args:
            seed: one seed; None takes all.

        Returns:
            Columns `seed` and `step`, then one for each quantity that any seed logged, by name; null where a step has
            no such number. Of a step that was logged twice, as after a kill, the later number holds.
        """
        import polars

        rows: dict[tuple[int, int], dict[str, Any]] = {}
        for one in self.seeds if seed is None else (seed,):
            for line in self.files.metrics(one):
                rows.setdefault((one, line["step"]), {"seed": one}).update(line)
        names = sorted({name for row in rows.values() for name in row} - {"seed", "step"})
        schema = {"seed": polars.Int64, "step": polars.Int64, **dict.fromkeys(names, polars.Float64)}
        return polars.DataFrame([rows[place] for place in sorted(rows)], schema=schema, strict=False)
