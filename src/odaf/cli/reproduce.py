"""`odaf reproduce STUDY`: measure a whole study with one command that can be stopped and repeated."""

import contextlib
import dataclasses
import difflib
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from odaf.cli.interrupts import repeatable
from odaf.cli.options import parse
from odaf.cli.results import table
from odaf.errors import ConfigError
from odaf.studies.registry import STUDIES

if TYPE_CHECKING:
    from odaf.studies.executor import Executor
    from odaf.studies.job import Job, Study
    from odaf.studies.ledger import Ledger
    from odaf.studies.listing import Holding

# Of the minutes: the rest is for scores with more episodes, and for what is not trained in lanes.
_SHARE_OF_LANES = 0.75
# Names of missing records that a listing writes out.
_NAMED = 20


@dataclasses.dataclass(frozen=True)
class ReproduceOptions:
    """Measure a whole study: every record a JSON file of its own, then tables and figures drawn from those files."""

    study: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="STUDY")] = ""
    """What to measure; without it, the studies are listed."""
    list: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Measure nothing: say what the study, or every study, costs, and which of its records are there and count."""
    minutes: Annotated[float | None, tyro.conf.arg(metavar="N")] = None
    """Stop after so many minutes, and do first what says most; see above."""
    workers: int = 1
    """Jobs at the same time, each in a process on cores of its own."""
    ray: Annotated[str | None, tyro.conf.arg(metavar="ADDRESS")] = None
    """Do the jobs on a Ray cluster, each on one of its cores: auto finds the one that was started on this machine,
    HOST:PORT names a head, local starts one here. The machines share --work. Needs the extra `ray`."""
    only: Annotated[tuple[str, ...], tyro.conf.arg(metavar="WORD ...")] = ()
    """Measure only a part: methods, tasks and the like. Words of one kind widen the choice, of two kinds narrow it."""
    phase: Annotated[tuple[int, ...], tyro.conf.arg(metavar="NUMBER ...")] = ()
    """Measure only these phases of the plan, from 1; those that say most for their cost come first."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """The ledger: directory of the records, the tables and the figures; without it, results/STUDY."""
    lanes: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Train what shares a program in lanes of it, as many as the memory holds, before the records are made: for a
    machine with an accelerator. With --minutes, three quarters of them go into that."""
    ledger: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Put new records, and the policies they are of, into this folder, and leave --out as it is: to carry them to
    another machine."""
    merge: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Measure nothing: take the records of such a folder into the ledger, those that say what would be measured now."""
    work: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Directory of data and runs, which may be thrown away once the records are there; without it, runs/STUDY. Studies
    that are given one directory share the policies that both need."""
    data: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None
    """Learn from the public files in this directory (hopper_medium-v2.hdf5 and so on) in place of logs recorded here;
    the ledger is then results/STUDY-public."""
    page: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Measure nothing: write what the ledger holds as one HTML page, with verdict, figures, tables and protocol."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    named = next((word for word in arguments if word in STUDIES), None)
    options: Any = parse(_options(named), arguments, "reproduce")
    if options.list and not options.study:
        return _list_all(options)
    if not options.study and arguments:
        raise ConfigError(f"name a study first, as in `odaf reproduce pointmaze`; known are {', '.join(STUDIES)}")
    if not options.study:
        print(f"{_studies()}\n\n`odaf reproduce STUDY` measures one, `odaf reproduce --list` says what each costs")
        return None
    if options.study not in STUDIES:
        near = difflib.get_close_matches(options.study, STUDIES, n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise ConfigError(f"there is no study {options.study!r}; {hint}known are {', '.join(STUDIES)}")
    if options.minutes is not None and not options.minutes > 0:
        raise ConfigError(f"--minutes {options.minutes:g}: must be more than 0; leave it out to measure everything")
    if options.workers < 1:
        raise ConfigError(f"--workers {options.workers}: must be at least 1")
    if options.ray is not None:
        options = _for_cluster(options)
    study = _on_files(STUDIES[options.study], options.data)
    study = study.among(_places(study, options)[0].parent)
    if options.page is not None:
        return _draw(study, options, options.page)
    return _list_one(study, options) if options.list else _measure(study, options)


def _for_cluster(options: ReproduceOptions) -> ReproduceOptions:
    """The same, with directories that mean the same in processes that were begun elsewhere."""
    if options.workers != 1:
        raise ConfigError(
            "--workers: with --ray there are as many jobs at the same time as the cluster has cores; leave it out"
        )
    if options.lanes:
        raise ConfigError("--lanes: trains in this process, and --ray on a cluster; leave one of them out")
    work = options.work or Path("runs") / options.study
    data = None if options.data is None else options.data.absolute()
    return dataclasses.replace(options, work=work.absolute(), data=data)


def _on_files(study: "Study", data: Path | None) -> "Study":
    if data is None:
        return study
    if study.on_files is None:
        able = ", ".join(name for name, other in STUDIES.items() if other.on_files is not None)
        raise ConfigError(f"--data: {study.name} records its logs itself; studies that take public files are {able}")
    if not data.is_dir():
        raise ConfigError(f"--data {data}: there is no such directory; name the one that holds the public files")
    return study.on_files(data)


def _draw(study: "Study", options: ReproduceOptions, page: Path) -> None:
    from odaf.studies.ledger import Ledger
    from odaf.studies.page import build

    out, _ = _places(study, options)
    command = f"odaf reproduce {study.name}" + ("" if options.data is None else " --data DIR")
    print(f"{study.name}: {build(Ledger(study, out), page, command)}; the page is {page}")


def _measure(study: "Study", options: ReproduceOptions) -> None:
    from odaf.studies.job import chosen
    from odaf.studies.lanes import at_its_end, keep_actors, on_processors
    from odaf.studies.ledger import Ledger
    from odaf.studies.news import Display
    from odaf.studies.perform import perform

    out, work = _places(study, options)
    jobs, ledger = chosen(study, options.phase, options.only), Ledger(study, out)
    if options.merge is not None:
        return _merge(ledger, Ledger(study, options.merge))
    costs, minutes = _costs(study, ledger), options.minutes
    if options.ledger is not None:
        jobs = [job for job in jobs if ledger.standing(job).state != "held"]
        ledger = Ledger(study, options.ledger)
    begun = time.monotonic()

    def measure(some: Sequence["Job"], minutes: float | None) -> None:
        perform(ledger, some, work, executor, Display(study.name), minutes=minutes, costs=costs)

    def left() -> float | None:
        return None if minutes is None else max(1e-3, minutes - (time.monotonic() - begun) / 60.0)

    with repeatable(), _executor(options) as executor:
        if options.lanes:
            in_time = _train_together(ledger, jobs, work, minutes)
            with on_processors():
                measure([job for job in jobs if at_its_end(job, work)], left())
            # What was cut off goes on in lanes next time: alone, one would take the time of all.
            others = [job for job in jobs if in_time and not at_its_end(job, work)]
            if others:
                measure(others, left())
        else:
            measure(jobs, minutes)
        if options.ledger is not None:
            keep_actors(ledger, jobs, work)
    print(f"The records are in {ledger.out}, drawn as {', '.join([*study.tables, *study.figures])}")
    if options.ledger is not None:
        print(f"Take them over with: odaf reproduce {study.name} --merge {options.ledger}")


def _executor(options: ReproduceOptions) -> "AbstractContextManager[Executor]":
    if options.ray is not None:
        from odaf.studies.on_ray import joined

        return joined(options.ray)
    from odaf.studies.executor import Here

    return contextlib.nullcontext(Here(options.workers))


def _train_together(ledger: "Ledger", jobs: Sequence["Job"], work: Path, minutes: float | None) -> bool:
    """Trains in lanes what is missing; returns whether all was trained in its share of the minutes."""
    from odaf.studies.lanes import train_together
    from odaf.training.progress import default_progress

    missing = [job for job in jobs if ledger.standing(job).state != "held"]
    until = None if minutes is None else time.monotonic() + _SHARE_OF_LANES * 60.0 * minutes
    report = default_progress(True)
    in_time = train_together(missing, work, report, until=until)
    if not in_time:
        report.message("time is up for training; the same command goes on where it stopped")
    return in_time


def _merge(ledger: "Ledger", other: "Ledger") -> None:
    from odaf.studies.lanes import merge

    if not other.out.is_dir():
        raise ConfigError(f"--merge {other.out}: there is no such folder; give the one that --ledger named")
    found = merge(ledger, other)
    for name, why in found.refused.items():
        print(f"not taken: {name}: {why}")
    print(f"{len(found.taken)} records taken into {ledger.out}, {len(found.known)} were there already")


def _list_all(options: ReproduceOptions) -> None:
    from odaf.studies.ledger import Ledger, stale
    from odaf.studies.listing import holding, known_costs

    if options.out is not None or options.work is not None or options.only or options.phase or options.data is not None:
        raise ConfigError(
            "--list: name a study first to list a part of it or another ledger, as in "
            "`odaf reproduce pointmaze --list --out DIR`"
        )
    costs, rows, stale_records = known_costs(STUDIES.values(), Path("results")), [], []
    for named in STUDIES.values():
        out, work = _places(named, options)
        study = named.among(out.parent)
        ledger = Ledger(study, out)
        standings = [ledger.standing(job) for job in study.jobs()]
        rows.append(holding(study.name, standings, costs, work))
        stale_records += [f"{out}/{line}" for line in stale(standings)]
    _print(rows, stale_records)
    print(f"\n{_studies()}\n\n`odaf reproduce STUDY --list` shows the phases of one")


def _list_one(study: "Study", options: ReproduceOptions) -> None:
    from odaf.studies.job import chosen
    from odaf.studies.ledger import Ledger, stale
    from odaf.studies.listing import by_phase, holding

    out, work = _places(study, options)
    ledger = Ledger(study, out)
    costs = _costs(study, ledger)
    standings = [ledger.standing(job) for job in chosen(study, options.phase, options.only)]
    part = bool(options.phase or options.only)
    rows = [] if part else by_phase(ledger, costs, work)
    rows.append(holding("the part asked for" if part else "in all", standings, costs, work))
    print(f"{study.name}: {study.summary}\n")
    _print(rows, stale(standings))
    missing = [standing.job.name for standing in standings if standing.state == "missing"]
    if missing:
        more = f", and {len(missing) - _NAMED:,} more" if len(missing) > _NAMED else ""
        print(f"\nmissing, in the order in which they would be measured: {', '.join(missing[:_NAMED])}{more}")


def _print(rows: Sequence["Holding"], stale_records: Sequence[str]) -> None:
    from odaf.studies.cost import minutes

    cells = [
        [
            row.title,
            f"{row.held} of {row.jobs}",
            str(row.stale),
            minutes(row.seconds),
            minutes(row.left) if row.held < row.jobs else "-",
        ]
        for row in rows
    ]
    print(table(["", "held", "stale", "of one core", "still to go"], cells))
    if stale_records:
        print("\nstale, because they say something else than would be measured today:")
        print("\n".join(f"  {line}" for line in stale_records))


def _costs(study: "Study", ledger: Any) -> Any:
    """Estimates from this ledger, and from those of all studies where they lie by default."""
    from odaf.studies.cost import Costs
    from odaf.studies.listing import records_of

    measured = records_of(ledger)
    for other in STUDIES.values():
        ledger_there = type(ledger)(other.among(Path("results")), Path("results") / other.name)
        if ledger_there.out.resolve() != ledger.out.resolve():
            measured = records_of(ledger_there) + measured  # this ledger's own come last, and count
    return Costs(measured)


def _places(study: "Study", options: ReproduceOptions) -> tuple[Path, Path]:
    ledger = study.name if options.data is None else f"{study.name}-public"
    return options.out or Path("results") / ledger, options.work or Path("runs") / study.name


_HOW = (
    "A record that is there and says what would be measured today is not measured again, so the command can be stopped "
    "and given again.",
    "With --minutes, the order of the plan is the priority: phase by phase, and in a phase the first seed of every "
    "method on one task, then on the next task, before any second seed. What is too long for the time that is left "
    "makes room for what fits. When nothing fits, the first that is too long is begun; it goes on from its last "
    "checkpoint next time.",
)


def _options(named: str | None) -> type[ReproduceOptions]:
    """The options, with a help page that knows the studies, or the one that is named."""
    lines = _studies() if named is None else _parts(STUDIES[named])
    text = "\n\n".join([ReproduceOptions.__doc__ or "", *_HOW, lines])
    kind = type("ReproduceOptions", (ReproduceOptions,), {"__doc__": text})
    return dataclasses.dataclass(frozen=True)(kind)


def _studies() -> str:
    return "studies:\n" + "\n".join(f"  {name}: {study.summary}" for name, study in STUDIES.items())


def _parts(study: "Study") -> str:
    """What `--phase` and `--only` take in this study."""
    from odaf.studies.job import labels_of

    phases = "\n".join(f"  {number}: {phase.title}" for number, phase in enumerate(study.plan(), start=1))
    words = "\n".join(f"  {kind}: {', '.join(found)}" for kind, found in labels_of(study.jobs()).items())
    return f"{study.name}: {study.summary}.\n\nphases:\n{phases}\n\nwords of --only:\n{words}"
