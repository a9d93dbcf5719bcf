"""The logs that studies learn from: scripted drivers in a maze, and locomotion sets recorded on the spot."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odaf.errors import ConfigError
from odaf.studies.job import Log

if TYPE_CHECKING:
    from odaf.environments.stitch_config import StitchConfig
    from odaf.evaluation.runs import Run

LOCAL = "locally generated data"


def origin_of(data: Mapping[str, Any]) -> str:
    """What tables call the data of a record: where they come from, and of which edition the policies in them are."""
    return LOCAL if data.get("edition") is None else f"{LOCAL}, edition {data['edition']}"


@dataclass(frozen=True)
class MazeLog(Log):
    """Poor demonstrations in a maze, each cell of the good path visited, the path itself never driven.

    A log of another seed than 0, of several drivers, or of a part of the episodes says so in its name, as
    `stitch-log2-broad-10`.

    Attributes:
        maze: name in `stitch_config.CONFIGS`.
        seed: of the drivers.
        repeats: episodes of each route in place of the configuration's, for a small log; None keeps those.
        episodes: starts over which the scripted drivers of `figures` are averaged.
        broad: whether nine drivers take turns (`stitch_config.BROAD`) in place of one.
        percent: share of each route's episodes, the first ones.
    """

    maze: str
    seed: int = 0
    repeats: int | None = None
    episodes: int = 50
    broad: bool = False
    percent: int = 100

    @property
    def name(self) -> str:
        return self._name(f"log{self.seed}" if self.seed else "")

    @property
    def known_as(self) -> str:
        return self._name("")

    def _name(self, seed: str) -> str:
        parts = [self.maze, seed, "broad" if self.broad else "", "" if self.percent == 100 else str(self.percent)]
        return "-".join(part for part in parts if part)

    def config(self) -> "StitchConfig":
        """What is driven."""
        from odaf.environments.stitch_config import BROAD, CONFIGS

        config = CONFIGS[self.maze] if self.repeats is None else CONFIGS[self.maze].with_repeats(self.repeats)
        return (config.driven_by(BROAD) if self.broad else config).part(self.percent)

    def recipe(self) -> dict[str, Any]:
        from odaf.training.files import plain

        config = {key: value for key, value in self.config().to_dict().items() if key != "accept"}
        return plain({"kind": "maze", "version": 1, "seed": self.seed, "config": config})

    def make(self, path: Path) -> None:
        from odaf.environments.stitch_data import generate

        generate(self.config(), seed=self.seed).save(path)

    def figures(self, run: "Run") -> dict[str, Any]:
        """What a record keeps of the data: their returns, and what the scripted driver earns who is sent straight to
        the goal's cell (`direct_return`) or to the hidden target (`ceiling`)."""
        summary, (direct, ceiling) = run.data["summary"], _direct_returns(self.maze, self.repeats, self.episodes)
        return {
            **{key: summary[key] for key in ("transitions", "episodes", "mean_return", "best_return")},
            "direct_return": direct,
            "ceiling": ceiling,
        }


@cache
def _direct_returns(maze: str, repeats: int | None, episodes: int) -> tuple[float, float]:
    from odaf.environments.stitch_data import direct_controller_return

    config = MazeLog(maze, repeats=repeats).config()
    direct, ceiling = (
        float(direct_controller_return(config, episodes, knows_target=knows).mean()) for knows in (False, True)
    )
    return direct, ceiling


@dataclass(frozen=True)
class RecordedLog(Log):
    """A locomotion set, recorded by the policies that come with the package.

    Attributes:
        set_name: as in `hopper-medium`.
        transitions: rows.
        seed: of starts and actions.
        edition: of the policies; None is the newest.
        seeded: whether its name says its seed, as `hopper-medium-log4`, for a study of logs of several seeds.
    """

    set_name: str
    transitions: int = 200_000
    seed: int = 0
    edition: int | None = None
    seeded: bool = False

    @property
    def name(self) -> str:
        return f"{self.set_name}-log{self.seed}" if self.seeded else self.set_name

    @property
    def known_as(self) -> str:
        return self.set_name if self.seeded else self.name

    def recipe(self) -> dict[str, Any]:
        return {
            "kind": "recorded",
            "version": 1,
            "set": self.set_name,
            "transitions": self.transitions,
            "seed": self.seed,
            "policies_sha256": policies_print(self.set_name, self.edition),
        }

    def make(self, path: Path) -> None:
        from odaf.environments.locomotion_data import generate

        generate(self.set_name, self.transitions, self.seed, edition=self.edition).save(path)

    def figures(self, run: "Run") -> dict[str, Any]:
        """What a record keeps of the data: the returns of their whole episodes, and how to make them again."""
        logged = run.data["summary"]["provenance"]["statistics"]
        edition = edition_of(self.set_name, self.edition)
        return {
            "same_set": command_for(self.set_name, self.transitions, self.seed, edition),
            "edition": edition,
            "transitions": logged["transitions"],
            "whole_episodes": logged["whole_episodes"],
            "mean_return": logged.get("mean"),
            "best_return": logged.get("best"),
            "normalised_score": logged.get("normalised_mean"),
        }


@dataclass(frozen=True)
class MixedLog(Log):
    """Few rows of a robot's expert, then many random ones: `hopper-mixture-80` has 80 % random rows. A log of another
    size than 100,000 rows says so in its name, as `hopper-mixture-80-1000k`.

    Attributes:
        robot: as in `hopper`.
        random_percent: of the rows.
        transitions: rows.
        seed: of starts and actions, in both parts.
        seeded: whether its name says its seed, as `hopper-mixture-80-log4`.
    """

    robot: str
    random_percent: int = 80
    transitions: int = 100_000
    seed: int = 0
    seeded: bool = False

    @property
    def name(self) -> str:
        return f"{self.known_as}-log{self.seed}" if self.seeded else self.known_as

    @property
    def known_as(self) -> str:
        size = "" if self.transitions == 100_000 else f"-{self.transitions / 1000:g}k"
        return f"{self.robot}-mixture-{self.random_percent}{size}"

    @property
    def parts(self) -> tuple[RecordedLog, RecordedLog]:
        """The expert's rows and the random ones."""
        random_rows = self.transitions * self.random_percent // 100
        return (
            RecordedLog(f"{self.robot}-expert", self.transitions - random_rows, self.seed),
            RecordedLog(f"{self.robot}-random", random_rows, self.seed),
        )

    def recipe(self) -> dict[str, Any]:
        expert, other = self.parts
        return {"kind": "mixed", "version": 1, "expert": expert.recipe(), "random": other.recipe()}

    def make(self, path: Path) -> None:
        from odaf.data.mixing import mix
        from odaf.environments.locomotion_data import generate

        expert, other = (generate(part.set_name, part.transitions, part.seed) for part in self.parts)
        mix(expert, other, self.random_percent / 100, self.transitions).save(path)

    def figures(self, run: "Run") -> dict[str, Any]:
        """What a record keeps of the data: the returns of all their episodes, their mean as a score, and the edition of
        the expert."""
        from odaf.environments.reference_returns import reference_of

        summary, reference = run.data["summary"], reference_of(run.data["environment"]["id"])
        kept = {key: summary[key] for key in ("transitions", "episodes", "mean_return", "best_return")}
        score = None if reference is None else reference.normalise(summary["mean_return"])
        edition = edition_of(self.parts[0].set_name)
        return {**kept, "edition": edition, "random_percent": self.random_percent, "normalised_score": score}


def edition_of(set_name: str, edition: int | None = None) -> int | None:
    """The edition of a set by its number, where None is the newest; None where no policy of ours plays in it."""
    from odaf.environments.locomotion_data import split_name
    from odaf.environments.shipped_policies import shipped

    task, kind = split_name(set_name)
    return None if kind == "random" else shipped(task, edition).facts["edition"]


def command_for(set_name: str, transitions: int, seed: int, edition: int | None) -> str:
    """What records the same set again. It names the edition, which need not be the newest by then."""
    named = "" if edition is None else f" --edition {edition}"
    return f"odaf data generate {set_name} --transitions {transitions} --seed {seed}{named} --out FILE"


@cache
def policies_print(set_name: str, edition: int | None = None) -> str | None:
    """A fingerprint of the policies that play in the sets of a task; None where they are not shipped, "none" where
    actions are drawn uniformly.

    It covers what they do, their parameters, spreads and turns; not the notes of how they were trained.
    """
    from odaf.environments.locomotion_data import split_name
    from odaf.environments.shipped_policies import shipped

    task, kind = split_name(set_name)
    if kind == "random":
        return "none"
    try:
        policies = shipped(task, edition)
    except ConfigError:
        return None
    needed = {"medium-replay": [policies.replay], "medium-expert": [policies.medium, policies.expert]}
    if not all(needed.get(kind, [getattr(policies, kind, None)])):
        return None
    digest = sha256()
    for steps, policy in [
        (0, policies.medium),
        (0, policies.expert),
        *((phase.steps, phase.policy) for phase in policies.replay),
    ]:
        digest.update(json.dumps([steps, None if policy is None else policy.spread]).encode())
        for array in () if policy is None else (*policy.weights, *policy.biases):
            digest.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
    return digest.hexdigest()
