"""The generators' study: is every locomotion and ant-maze set that we can record what its name says?

A set is recorded again once the policies that play in it are others; sets without a policy are listed as such.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odaf.studies import ant_maze_recordings
from odaf.studies.ant_maze_logs import walker_print
from odaf.studies.ant_maze_recordings import AntMazeRecording
from odaf.studies.job import DataEntries, Job, Phase, Record, Study, Work
from odaf.studies.logs import LOCAL, command_for, edition_of, policies_print

if TYPE_CHECKING:
    from odaf.training.progress import ProgressReport

TRANSITIONS = 100_000
SEED = 0
VERSION = 3  # of what a record holds: 2 looks at the spread of returns, 3 says which edition was played and by whom


@dataclass(frozen=True)
class Recording(Work):
    """One set recorded, its figures beside the published set's.

    Attributes:
        set_name: as in `hopper-medium`.
        transitions: rows.
        seed: of starts and actions.
    """

    set_name: str
    transitions: int = TRANSITIONS
    seed: int = SEED

    @property
    def labels(self) -> dict[str, tuple[str, ...]]:
        from odaf.environments.locomotion_data import split_name

        task, kind = split_name(self.set_name)
        return {"task": (task.name,), "kind": (kind,), "set": (self.set_name,)}

    def identity(self) -> dict[str, Any]:
        return {
            "version": VERSION,
            "transitions": self.transitions,
            "seed": self.seed,
            "policies_sha256": policies_print(self.set_name),
        }

    def recorded(self, record: Record, data: DataEntries) -> dict[str, Any]:
        del data
        return {
            **record.get("identity", {}),
            "transitions": record["statistics"]["transitions"],
            "seed": record["seed"],
            "policies_sha256": record["policies_sha256"],
        }

    def unrecorded(self) -> dict[str, Any]:
        return {"version": 1}  # whose acceptance did not look at the spread of returns

    def guess(self) -> float:
        return 15.0

    def said(self, record: Record) -> str:
        verdict = {True: "accepted", False: "not accepted", None: "unknown"}[record["acceptance"]["passed"]]
        return f"{verdict}, {record['transitions_per_second']:,.0f} transitions/s"

    def do(self, place: Path, progress: "ProgressReport") -> Record:
        from odaf.data import fingerprint
        from odaf.environments.locomotion_data import generate

        began, used = time.monotonic(), time.process_time()
        dataset = generate(self.set_name, self.transitions, self.seed, progress=progress)
        seconds, processor_seconds = time.monotonic() - began, time.process_time() - used
        edition = edition_of(self.set_name)
        return {
            "origin": LOCAL,
            "same_set": command_for(self.set_name, self.transitions, self.seed, edition),
            "edition": edition,
            "identity": {"version": VERSION},
            "policies_sha256": policies_print(self.set_name),
            **fingerprint.record(dataset),
            "seconds": seconds,
            "processor_seconds": processor_seconds,
            "transitions_per_second": self.transitions / seconds,
            **{key: dataset.provenance[key] for key in ("name", "seed", "environment", "policies", "versions")},
            **{key: dataset.provenance[key] for key in ("statistics", "acceptance", "findings")},
        }


def plan() -> list[Phase]:
    """A phase for each robot, with the sets that have their policies, and one for the ants in mazes."""
    from odaf.environments.ant_maze_sets import NAMES as MAZES
    from odaf.environments.locomotion_data import NAMES, split_name

    phases: dict[str, list[Job]] = {}
    for name in NAMES:
        if policies_print(name) is not None:
            phases.setdefault(split_name(name)[0].name, []).append(Job(name, Recording(name)))
    robots = [Phase(f"the sets of {task}", tuple(jobs)) for task, jobs in phases.items()]
    mazes = tuple(Job(name, AntMazeRecording(name)) for name in MAZES) if walker_print() is not None else ()
    return [*robots, *([Phase("the sets of ants in mazes", mazes)] if mazes else [])]


def table(records: Sequence[Record]) -> str:
    """Markdown table: a row a set, what its episodes earn beside what the published set's do."""
    from odaf.environments.locomotion_acceptance import SPREAD_FACTOR
    from odaf.environments.locomotion_data import NAMES

    by_name = {record["name"]: record for record in records}
    lines = [
        f"Sets recorded by our own policies: {LOCAL}, {TRANSITIONS:,} transitions each, of the editions named.",
        "Scores are normalised, 0 for a random policy and 100 for an expert, and belong to the environment named; the",
        "raw return stands beside them, mean ± standard deviation over episodes. Limits are the published set's mean",
        f"within 3 points (8 for medium-replay), and for medium and expert at most {SPREAD_FACTOR} times its standard",
        "deviation of returns, for each half of medium-expert on its own. Speeds are by the clock, on a machine that",
        "may be busy with other work, and by processor time.",
        "Made by `odaf reproduce generators` from the records in this folder.",
        "",
        "| set | edition | environment | whole episodes | return | published ± | ± at most | score | expected "
        "| falls a row | accepted | transitions/s | by processor time |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name in NAMES:
        if name not in by_name:
            lines.append(f"| {name} | | | | | | | | | | no policy shipped | | |")
            continue
        record = by_name[name]
        for part, figures in (record["statistics"].get("parts") or {"": record["statistics"]}).items():
            lines.append(_row(name, part, figures, record))
    missing = [name for name in NAMES if name in by_name and by_name[name]["acceptance"]["passed"] is not True]
    if missing:
        lines += ["", "Not accepted, check by check:", ""]
        for name in missing:
            lines += [f"- `{name}`: {finding['message']}" for finding in by_name[name]["findings"]]
    lines += ant_maze_recordings.table(records)
    return "\n".join(lines) + "\n"


def _row(name: str, part: str, figures: Mapping[str, Any], record: Mapping[str, Any]) -> str:
    from odaf.environments.locomotion_acceptance import SPREAD_FACTOR

    prefix = f"{part}/" if part else ""
    checks = {
        check["figure"].removeprefix(prefix): check
        for check in record["acceptance"]["checks"]
        if check["figure"].startswith(prefix)
    }
    score, spread = checks.get("normalised_mean"), checks.get("std")
    edition = "" if record["edition"] is None else record["edition"]
    title = f"{f'{name}, {part} half' if part else name} | {edition}"
    if score is None:
        return f"| {title} | {record['environment']['id']} | 0 | | | | | | | unknown | | |"
    passed = "yes" if all(check["passed"] for check in checks.values()) else "no"
    widest = "| | |" if spread is None else f"| {spread['highest'] / SPREAD_FACTOR:,.1f} | {spread['highest']:,.1f} |"
    return (
        f"| {title} | {figures['environment']} | {figures['whole_episodes']:,} "
        f"| {figures['mean']:,.1f} ± {figures['std']:,.1f} {widest} {figures['normalised_mean']:.1f} "
        f"| {score['lowest']:.1f} to {score['highest']:.1f} | {figures['terminal_row_share']:.4f} "
        f"| {passed} | {record['transitions_per_second']:,.0f} | {TRANSITIONS / record['processor_seconds']:,.0f} |"
    )


STUDY = Study(
    "generators",
    "every locomotion set we can record, beside the published set of its name, and the ant mazes",
    plan,
    {"table.md": table},
    {"coverage.png": ant_maze_recordings.figure},
)
