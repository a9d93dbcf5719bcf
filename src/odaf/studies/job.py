"""What a study is made of: jobs, each with the record it leaves, in phases, and the tables drawn from the records."""

import abc
import json
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odaf.errors import ConfigError

if TYPE_CHECKING:
    from odaf.studies.verdict import Claim
    from odaf.training.progress import ProgressReport

Record = dict[str, Any]
"""One JSON file of a ledger."""

PRINTS = ("rows_sha256", "sha256")
"""What records call the fingerprint of a log's rows, and that of the whole file, notes included; either will do."""

DataEntries = Mapping[str, Mapping[str, Any]]
"""For each log of a ledger its recipe, and the fingerprints under which its rows are known."""


class Work(abc.ABC):
    """What a job does. Concrete ones are frozen dataclasses: they travel to other processes, and equal ones are equal.

    A work makes what it needs and does not find: a log, or the policies that it attacks. So any part of a study can be
    asked for, on a machine that has nothing but the ledger.
    """

    @abc.abstractmethod
    def do(self, place: Path, progress: "ProgressReport") -> Record:
        """Does it, or goes on with it.

        Args:
            place: directory for what may be thrown away once the record is there: data, runs.
            progress: hears how far it has come.

        Returns:
            The record, without paths of this machine; "seconds" is what it took, or a table whose "total" is.
        """

    @abc.abstractmethod
    def identity(self) -> dict[str, Any]:
        """Everything that decides the record's figures, as JSON types and as today's code has it.

        Settings are resolved, data are told by how they are made, and code by a version that is raised when it
        measures something else.
        """

    def recorded(self, record: Record, data: DataEntries) -> dict[str, Any]:
        """The same of a record, in today's terms; `data` are the logs that its ledger knows."""
        del data
        return dict(record.get("identity", {}))

    def unrecorded(self) -> dict[str, Any]:
        """For fields of the identity that older records do not state, by dotted name: what held for them."""
        return {}

    @property
    def log(self) -> "Log | None":
        """The log that it needs; None where it needs none."""
        return None

    @property
    def labels(self) -> dict[str, tuple[str, ...]]:
        """By kind of word, as in {"method": ("odaf",)}: the words of `--only` that mean this work."""
        return {}

    @property
    def line(self) -> str | None:
        """Works of one line share what they leave in the work directory: the longer goes on where the shorter ended."""
        return None

    @property
    def amount(self) -> float:
        """How much is to be done, in units that take equally long for works that are alike."""
        return 1.0

    def amount_done(self, place: Path) -> float:
        """How much of it lies in the work directory already."""
        del place
        return 0.0

    def likeness(self) -> tuple[Hashable, ...]:
        """What other works of about the same cost share with this one, from most to least alike."""
        return (type(self).__name__,)

    def guess(self) -> float:
        """Seconds of one core for a unit of `amount` where nothing like it was measured."""
        return 60.0

    def said(self, record: Record) -> str:
        """The record in a few words, for the line that says it is there."""
        del record
        return "done"


class Log(abc.ABC):
    """Data to learn from. Concrete ones are frozen dataclasses."""

    @property
    @abc.abstractmethod
    def name(self) -> str:
        """What the ledger and the file call it."""

    @property
    def known_as(self) -> str:
        """What presets call it that have values for it: its name, without a seed of its own."""
        return self.name

    @abc.abstractmethod
    def recipe(self) -> dict[str, Any]:
        """Everything that decides its rows, as JSON types; "version" is raised when the same recipe makes others."""

    @abc.abstractmethod
    def make(self, path: Path) -> None:
        """Writes it to `path`."""

    def file(self, place: Path) -> Path:
        """Where it lies in a work directory; another recipe lies in another file."""
        return place / f"{self.name}-{short_print(self.recipe())}.h5"

    def present(self, place: Path) -> Path:
        """The same file, made if it is not there."""
        path = self.file(place)
        if not path.exists():
            path.parent.mkdir(parents=True, exist_ok=True)
            self.make(path)
        return path


@dataclass(frozen=True)
class Job:
    """One record of a study, and how it comes about.

    Attributes:
        name: of its record, without the ending; no two jobs of a study share it.
        do: the work.
        after: names of jobs that must not be under way at the same time, and go first where both are to be done.
    """

    name: str
    do: Work
    after: tuple[str, ...] = ()


@dataclass(frozen=True)
class Phase:
    """A part of a study that can be asked for by its number.

    Attributes:
        title: what it answers, in a few words.
        jobs: in the order in which they are worth doing.
    """

    title: str
    jobs: tuple[Job, ...]


@dataclass(frozen=True)
class Study:
    """What one `odaf reproduce` measures.

    Attributes:
        name: on the command line, and of its folder in `results`.
        summary: what it asks, in a line.
        plan: its phases, the ones that say most for their cost first. Called when the study is wanted, so that
            nothing is looked up at import.
        tables: for each Markdown file, its text from the records that count, in the order of their names.
        figures: for each picture, what draws it to a path from the same records.
        claim: of the paper's that it decides, for those that decide one.
        on_files: the same study on public files in a directory, for those that can be measured on such.
        beside: the same study as the ledgers of others in a folder have it, for those whose plan goes by their records.
    """

    name: str
    summary: str
    plan: Callable[[], Sequence[Phase]]
    tables: Mapping[str, Callable[[Sequence[Record]], str]]
    figures: Mapping[str, Callable[[Sequence[Record], Path], object]] = field(default_factory=dict)
    claim: "Claim | None" = None
    on_files: "Callable[[Path], Study] | None" = None
    beside: "Callable[[Path], Study] | None" = None

    def among(self, results: Path) -> "Study":
        """Itself, with the plan that the ledgers in `results` ask for."""
        return self if self.beside is None else self.beside(results)

    def jobs(self) -> list[Job]:
        """Every job in the order of the plan.

        Raises:
            ValueError: two jobs share a name, or one comes after a job that the plan does not name before it.
        """
        jobs = [job for phase in self.plan() for job in phase.jobs]
        before: set[str] = set()
        for job in jobs:
            if job.name in before:
                raise ValueError(f"{self.name}: two jobs are called {job.name}")
            if missing := set(job.after) - before:
                raise ValueError(f"{self.name}: {job.name} comes after {sorted(missing)}, not in the plan before it")
            before.add(job.name)
        return jobs

    def draw(self, records: Sequence[Record], out: Path) -> None:
        """Writes the tables and figures of these records to `out`."""
        out.mkdir(parents=True, exist_ok=True)
        for file, table in self.tables.items():
            (out / file).write_text(table(records), encoding="utf-8")
        for file, figure in self.figures.items():
            figure(records, out / file)


def chosen(study: Study, phase: Sequence[int] = (), only: Sequence[str] = ()) -> list[Job]:
    """The part of a study that was asked for, in the order of the plan.

    Args:
        study: the study.
        phase: numbers of phases, from 1; none takes all.
        only: words that name methods, tasks and the like. Words of one kind widen the choice, of two kinds narrow it:
            `edac osr-10 hopper-medium` is both methods on that task.

    Raises:
        ConfigError: a number or a word is not in the plan.
    """
    phases = study.plan()
    for number in phase:
        if not 1 <= number <= len(phases):
            raise ConfigError(f"--phase {number}: {study.name} has phases 1 to {len(phases)}")
    wanted: dict[str, set[str]] = {}
    known = labels_of(job for part in phases for job in part.jobs)
    for word in only:
        kinds = [kind for kind, words in known.items() if word in words]
        if not kinds:
            words = sorted({word for words in known.values() for word in words})
            raise ConfigError(f"--only {word}: is not part of {study.name}; known are {', '.join(words) or 'none'}")
        for kind in kinds:
            wanted.setdefault(kind, set()).add(word)
    return [
        job
        for number, part in enumerate(phases, start=1)
        for job in part.jobs
        if (not phase or number in phase)
        and all(words & set(job.do.labels.get(kind, ())) for kind, words in wanted.items())
    ]


def labels_of(jobs: Iterable[Job]) -> dict[str, list[str]]:
    """By kind, every word of `--only` that means one of these jobs, in the order of the plan."""
    found: dict[str, list[str]] = {}
    for job in jobs:
        for kind, words in job.do.labels.items():
            found.setdefault(kind, []).extend(word for word in words if word not in found.get(kind, ()))
    return found


def prints_of(data: Mapping[str, Any]) -> list[str]:
    """The fingerprints that a record, or a run's `data.json`, gives of its data: of their rows, of the file."""
    return [data[kind] for kind in PRINTS if data.get(kind) is not None]


def short_print(content: Mapping[str, Any]) -> str:
    """Eight hexadecimal digits that tell one content from another."""
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:8]
