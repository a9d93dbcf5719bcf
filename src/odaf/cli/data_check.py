"""`odaf data check`: can this log be learned from, and what stands in the way?"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from odaf.cli.bars import rows_bar
from odaf.cli.options import parse
from odaf.cli.outputs import CHECK_REPORT, check_outputs
from odaf.cli.readers import ReaderOptions, require_file
from odaf.cli.results import print_report

if TYPE_CHECKING:
    from odaf.data.checks import Report


@dataclass(frozen=True, kw_only=True)
class CheckOptions(ReaderOptions):
    """Say whether a log can be learned from: what is wrong, in which rows, how often, and what to do; then, of a log
    without errors, which method to begin with and why.

    Reads files of ours, of D4RL, Minari, OGBench, d3rlpy, LeRobot, Parquet and CSV, in one pass and without holding
    them in memory. Changes nothing. Ends with 0 if the log is usable, with 1 if it has warnings and --strict is given,
    with 2 if it has errors. docs/reference/checks.md says what each finding means for learning.
    """

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    """File or folder to look at."""
    strict: bool = False
    """End with 1 if there are warnings."""
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Write the report there too, with means, spreads and ranges of all columns."""
    env: Annotated[str | None, tyro.conf.arg(metavar="ID")] = None
    """Environment whose observations and actions the rows must fit, such as Hopper-v4."""
    force: bool = False
    """Write over a file of another kind, if one is there."""


def run(arguments: list[str]) -> int:
    """Entry point of the command."""
    options = parse(CheckOptions, arguments, "data check")
    require_file(options.file)
    check_outputs({"--json": (options.json, CHECK_REPORT)}, options.files_read(options.file), options.force)

    from odaf.data.checks import check_file
    from odaf.data.writing import write_text

    widths = None if options.env is None else _widths(options.env)
    with rows_bar("checking") as progress:
        report = check_file(options.file, options.format, widths=widths, progress=progress, **options.for_reader())
    print_report(report)
    print(f"\n{_advice(options, report)}")
    if options.json is not None:
        text = json.dumps(report.to_dict(), indent=2, allow_nan=False, ensure_ascii=False)
        write_text(options.json, text + "\n")
    return report.exit_code(options.strict)


def _advice(options: CheckOptions, report: "Report") -> str:
    """Which method to begin with, as the end of the page."""
    if report.advice is None:
        return "what to begin with: errors come first; mend them and check again"
    if not options.for_reader() and report.format not in ("csv", "parquet"):
        return (
            f"{report.advice.describe(str(options.file))}\n`odaf train auto --data FILE --out DIR` takes this advice."
        )
    return (
        f"{report.advice.describe('LOG.h5')}\n"
        "LOG.h5 is the log as `odaf data import` keeps it; `odaf train auto --data LOG.h5 --out DIR` takes this advice."
    )


def _widths(identity: str) -> tuple[int, int]:
    """Numbers in an observation and in an action of one of gymnasium's environments."""
    from odaf.environments import make

    environment = make({"name": "gymnasium", "id": identity})()
    try:
        spaces = environment.observation_space, environment.action_space
        return int(spaces[0].shape[0]), int(spaces[1].shape[0])  # type: ignore[index]
    finally:
        environment.close()
