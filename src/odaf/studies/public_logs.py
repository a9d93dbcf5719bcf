"""Public sets in files of their own, in the layout of D4RL: what scores beside the paper's must be learned from."""

from dataclasses import dataclass
from functools import cache
from hashlib import file_digest
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odaf.errors import ConfigError
from odaf.studies.job import Log

if TYPE_CHECKING:
    from odaf.data.dataset import Dataset
    from odaf.evaluation.runs import Run

PUBLIC = "public data"
MIXTURE_ROWS = 1_000_000


@dataclass(frozen=True)
class PublicLog(Log):
    """A public set, copied with the environment that its policies are tried in.

    Attributes:
        directory: where the file lies, as `hopper_medium-v2.hdf5` or `hopper-medium-v2.hdf5`.
        set_name: as in `hopper-medium`.
    """

    directory: Path
    set_name: str

    @property
    def name(self) -> str:
        return self.set_name

    @property
    def source(self) -> Path:
        """The file.

        Raises:
            ConfigError: it is not there.
        """
        robot, kind = self.set_name.split("-", 1)
        names = [
            f"{robot}{sign}{kind.replace('-', other)}-v2.hdf5" for sign, other in (("_", "_"), ("_", "-"), ("-", "-"))
        ]
        for name in names:
            if (self.directory / name).exists():
                return self.directory / name
        raise ConfigError(
            f"--data {self.directory}: has no file {' or '.join(names)}; put it there, or leave --data out"
        )

    def recipe(self) -> dict[str, Any]:
        path = self.source
        return {"kind": "public", "version": 1, "file": path.name, "sha256": _digest(path, path.stat().st_mtime_ns)}

    def make(self, path: Path) -> None:
        self.loaded().save(path)

    def loaded(self) -> "Dataset":
        """The file's rows, with the environment of the robot."""
        from odaf.data.dataset import Dataset
        from odaf.environments.locomotion import task_of

        dataset = Dataset.load(self.source)
        if dataset.environment is not None:
            return dataset
        robot = task_of(self.set_name.split("-")[0])
        return dataset.with_provenance(environment={"name": "gymnasium", "id": robot.environment_id("v4")})

    def figures(self, run: "Run") -> dict[str, Any]:
        """What a record keeps of the data: the returns of their episodes."""
        return {"origin": PUBLIC, "file": self.source.name, **_figures(run)}


@dataclass(frozen=True)
class PublicMixture(Log):
    """The first rows of a public expert set, then the first of a random one; as `MixedLog` of public files.

    Attributes:
        directory: where the two files lie.
        robot: as in `hopper`.
        random_percent: of the rows.
        transitions: rows.
    """

    directory: Path
    robot: str
    random_percent: int
    transitions: int = MIXTURE_ROWS

    @property
    def name(self) -> str:
        return f"{self.robot}-mixture-{self.random_percent}"

    @property
    def parts(self) -> tuple[PublicLog, PublicLog]:
        """The expert's file and the random one."""
        return PublicLog(self.directory, f"{self.robot}-expert"), PublicLog(self.directory, f"{self.robot}-random")

    def recipe(self) -> dict[str, Any]:
        expert, other = self.parts
        own = {"random_percent": self.random_percent, "transitions": self.transitions}
        return {"kind": "public mixture", "version": 1, **own, "expert": expert.recipe(), "random": other.recipe()}

    def make(self, path: Path) -> None:
        from odaf.data.mixing import mix

        expert, other = (part.loaded() for part in self.parts)
        rows = min(self.transitions, len(expert), len(other))  # a file that lost its last row has a few less
        mix(expert, other, self.random_percent / 100, rows).save(path)

    def figures(self, run: "Run") -> dict[str, Any]:
        """What a record keeps of the data: the returns of their episodes."""
        return {"origin": PUBLIC, "random_percent": self.random_percent, **_figures(run)}


def _figures(run: "Run") -> dict[str, Any]:
    from odaf.environments.reference_returns import reference_of

    summary, reference = run.data["summary"], reference_of(run.data["environment"]["id"])
    kept = {key: summary[key] for key in ("transitions", "episodes", "mean_return", "best_return")}
    return {**kept, "normalised_score": None if reference is None else reference.normalise(summary["mean_return"])}


@cache
def _digest(path: Path, changed: int) -> str:
    del changed  # a file that was written anew is read anew
    with path.open("rb") as file:
        return file_digest(file, "sha256").hexdigest()
