"""The ledger of a study: a directory with one JSON file a record, and what each of them is worth today.

NAME.json     a record
data.json     the logs that the records stand on: for each its recipe, and the fingerprints that its rows go by
*.md, *.png   drawn from the records that count
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from odaf.errors import ConfigError
from odaf.studies.identity import differences
from odaf.studies.job import Job, Log, Record, Study, prints_of

DATA = "data.json"


@dataclass(frozen=True)
class Standing:
    """Where a job stands.

    Attributes:
        job: the job.
        state: "held", its record counts; "stale", it says something else than today's code would measure; "missing".
        record: the record, if there is one.
        differences: of a stale record, field by field.
    """

    job: Job
    state: Literal["held", "stale", "missing"]
    record: Record | None
    differences: tuple[str, ...] = ()


class Ledger:
    """The records of one study in one directory; nothing is kept in memory but `data`, the logs they stand on.

    Args:
        study: whose records they are.
        out: the directory, which need not exist.

    Raises:
        ConfigError: `data.json` cannot be read.
    """

    def __init__(self, study: Study, out: Path):
        self.study, self.out = study, out
        written = _read(out / DATA, "make it again with another --out, or restore it") if (out / DATA).exists() else {}
        self.data: dict[str, dict[str, Any]] = {**self._data_of_records(), **written}

    def path(self, job: Job) -> Path:
        """The file of a job's record, there or not."""
        return self.out / f"{job.name}.json"

    def standing(self, job: Job) -> Standing:
        """Whether the job's record is there, and counts.

        Raises:
            ConfigError: it cannot be read.
        """
        record = self.record(job)
        if record is None:
            return Standing(job, "missing", None)
        found = self._differences(job, record)
        return Standing(job, "stale" if found else "held", record, tuple(found))

    def record(self, job: Job) -> Record | None:
        """The job's record, whatever it is worth; None where there is none."""
        path = self.path(job)
        return _read(path, "remove the file to measure it again") if path.exists() else None

    def held(self) -> list[Record]:
        """The records of the study that count, in the order of their files' names."""
        standings = [self.standing(job) for job in sorted(self.study.jobs(), key=self.path)]
        return [one.record for one in standings if one.state == "held" and one.record is not None]

    def write(self, job: Job, record: Mapping[str, Any]) -> Record:
        """Keeps a record that was just measured, and returns it as it stands in its file.

        Raises:
            ConfigError: it does not say what was asked for, which is a defect of the work or of the data in its way.
        """
        whole = {"study": self.study.name, "command": f"odaf reproduce {self.study.name}", **record}
        if found := self._differences(job, json.loads(json.dumps(whole))):
            raise ConfigError(f"{self.path(job)}: what was measured is not what was asked for: {'; '.join(found)}")
        _write(self.path(job), whole)
        return whole

    def note_log(self, log: Log, fingerprints: Sequence[str]) -> None:
        """Notes by which fingerprints a log that lies in the work directory goes; one that is known makes all known.

        Raises:
            ConfigError: its recipe is that of the records that are there, and its rows are not.
        """
        recipe, known = log.recipe(), self.data.get(log.name)
        if known is not None and not differences(known["recipe"], recipe):
            if not set(fingerprints) & set(known["sha256"]):
                before = " or ".join(one[:8] for one in known["sha256"])
                raise ConfigError(
                    f"{self.out}: its records of {log.name} stand on data with the fingerprint {before}; those made "
                    f"here have {fingerprints[0][:8]}, as another simulator or processor makes them. Measure into a "
                    "ledger of your own with --out DIR"
                )
            known["sha256"] += [one for one in fingerprints if one not in known["sha256"]]
        else:  # the first of this recipe: records of another one are stale by it
            known = {"recipe": recipe, "sha256": [*fingerprints]}
        self.data[log.name] = known
        _write(self.out / DATA, dict(sorted(self.data.items())))

    def learn_log(self, name: str, entry: Mapping[str, Any]) -> None:
        """Notes a log as another ledger knows it; prints of the same rows are added to those that are known."""
        known = self.data.get(name)
        prints = [] if known is None or differences(known["recipe"], entry["recipe"]) else known["sha256"]
        whole = list(dict.fromkeys([*prints, *entry["sha256"]]))
        self.data[name] = {"recipe": dict(entry["recipe"]), "sha256": whole}
        _write(self.out / DATA, dict(sorted(self.data.items())))

    def draw(self) -> None:
        """Draws the study's tables and figures from the records that count."""
        self.study.draw(self.held(), self.out)

    def _differences(self, job: Job, record: Record) -> list[str]:
        try:
            recorded = job.do.recorded(record, self.data)
        except (KeyError, TypeError) as error:
            return [f"it is no record of this kind of work ({type(error).__name__}: {error})"]
        return differences(recorded, job.do.identity(), job.do.unrecorded())

    def _data_of_records(self) -> dict[str, dict[str, Any]]:
        """A ledger from before `data.json`: its records are believed to stand on logs of today's recipes."""
        found: dict[str, dict[str, Any]] = {}
        for job in self.study.jobs():
            log, path = job.do.log, self.path(job)
            if log is None or not path.exists():
                continue
            record = _read(path, "remove the file to measure it again")
            entry = found.setdefault(log.name, {"recipe": log.recipe(), "sha256": []})
            entry["sha256"] += [one for one in prints_of(record.get("data", {})) if one not in entry["sha256"]]
        return found


def count(standings: Iterable[Standing]) -> dict[str, int]:
    """How many jobs are held, stale and missing."""
    states: dict[str, int] = {"held": 0, "stale": 0, "missing": 0}
    for standing in standings:
        states[standing.state] += 1
    return states


def stale(standings: Sequence[Standing], most: int = 2) -> list[str]:
    """A line for each stale record, with the first fields that differ."""
    lines = []
    for standing in standings:
        if standing.state == "stale":
            shown = "; ".join(standing.differences[:most])
            more = len(standing.differences) - most
            lines.append(f"{standing.job.name}: {shown}{f'; and {more} more' if more > 0 else ''}")
    return lines


def _read(path: Path, remedy: str) -> Record:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read as JSON ({error}); {remedy}") from None
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: holds {type(content).__name__} where a table should stand; {remedy}")
    return content


def _write(path: Path, content: Mapping[str, Any]) -> None:
    from odaf.training.files import write_json

    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, content)
