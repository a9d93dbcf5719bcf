"""`odaf data import`: a log of other people's, checked and kept in one file of ours."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from odaf.cli.bars import rows_bar
from odaf.cli.options import parse
from odaf.cli.outputs import DATASET, check_outputs
from odaf.cli.readers import ReaderOptions, require_file
from odaf.cli.results import number, print_report


@dataclass(frozen=True, kw_only=True)
class ImportOptions(ReaderOptions):
    """Check a log and keep it in one file: rows, names, units, where it came from, and what the checks found.

    A log with errors is not imported; the report says what to mend. Nothing is dropped, clipped or repaired in silence:
    `odaf data info` lists what was changed on the way in.

    A table from a plant:  odaf data import log.csv --observations level flow --actions valve --reward profit
    --episode batch --terminated tripped --action-bounds 0 100 --out valve.h5

    One as historians write it:  odaf data import log.csv --units-row --decimal-comma --missing-values "Bad,No Data"
    --on-missing break --observations level --observation "error = level - setpoint" --reward "-abs(level - setpoint)"
    --lags 2 --actions valve --episode shift --time time --out valve.h5
    """

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """File or folder to import."""
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")]
    """File to write."""
    accept: Annotated[tuple[str, ...], tyro.conf.arg(metavar="CHECK [CHECK ...]")] = ()
    """Checks whose errors are accepted, by the name in the report; they are recorded in the file. What no data set can
    hold, such as NaN, cannot be accepted."""
    force: bool = False
    """Write over a file of another kind, if one is there."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(ImportOptions, arguments, "data import")
    require_file(options.file)
    check_outputs({"--out": (options.out, DATASET)}, options.files_read(options.file), options.force)

    from odaf.data.checks import known, open_log
    from odaf.data.ingestion import ingest, refuse_hopeless

    refuse_hopeless(options.accept)
    log = open_log(options.file, options.format, **options.for_reader())
    with rows_bar("checking") as progress:
        dataset, report = ingest(log, accept=options.accept, progress=progress)
    if options.file.is_file():
        dataset = dataset.with_provenance(file_sha256=known.file_sha256(options.file))
    dataset.save(options.out)
    print_report(report)
    summary = dataset.summary()
    print(
        f"\nwrote {options.out}: {summary['episodes']:,} episodes, {summary['transitions']:,} transitions, "
        f"mean return {number(summary['mean_return'], 2)}, best {number(summary['best_return'], 2)}"
    )
