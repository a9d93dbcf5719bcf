"""What the studies cost and what a ledger already holds, as tables for `odaf reproduce --list`."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from odaf.studies.cost import Costs
from odaf.studies.job import Job, Record, Study
from odaf.studies.ledger import Ledger, Standing, count


@dataclass(frozen=True)
class Holding:
    """A study, or a part of it, in numbers.

    Attributes:
        title: the study's name, or the phase's number and title.
        jobs: how many records it has when it is complete.
        held: how many are there and count.
        stale: how many are there and do not.
        seconds: of one core, for all of it.
        left: of one core, for what is not held.
    """

    title: str
    jobs: int
    held: int
    stale: int
    seconds: float
    left: float


def known_costs(studies: Iterable[Study], results: Path) -> Costs:
    """Estimates from whatever the ledgers under `results` have measured, each in the folder of its study's name."""
    measured: list[tuple[Job, Record]] = []
    for study in studies:
        measured += records_of(Ledger(study.among(results), results / study.name))
    return Costs(measured)


def records_of(ledger: Ledger) -> list[tuple[Job, Record]]:
    """The jobs of a ledger that have a record, whatever it is worth, with it."""
    found = ((job, ledger.record(job)) for job in ledger.study.jobs())
    return [(job, record) for job, record in found if record is not None]


def holding(title: str, standings: Sequence[Standing], costs: Costs, place: Path) -> Holding:
    """The numbers of these jobs.

    Args:
        title: what to call them.
        standings: the jobs.
        costs: estimates.
        place: the work directory, where a part of what is missing may be done.
    """
    states = count(standings)
    missing = [standing.job for standing in standings if standing.state != "held"]
    whole = costs.total([standing.job for standing in standings])
    return Holding(title, len(standings), states["held"], states["stale"], whole, costs.total(missing, place))


def by_phase(ledger: Ledger, costs: Costs, place: Path) -> list[Holding]:
    """A study's numbers, phase by phase."""
    return [
        holding(f"{number}  {phase.title}", [ledger.standing(job) for job in phase.jobs], costs, place)
        for number, phase in enumerate(ledger.study.plan(), start=1)
    ]
