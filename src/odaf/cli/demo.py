"""`odaf demo`: stitch a maze from poor demonstrations, and look at the result."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from odaf.cli.interrupts import repeatable
from odaf.cli.options import parse
from odaf.cli.outputs import DATASET, DEMO_SUMMARY, PAGE, PICTURE, check_outputs


@dataclass(frozen=True)
class DemoOptions:
    """Record poor demonstrations in a maze, learn from them with three methods, and draw what came out.

    No demonstration takes the good path. The page at the end shows which method found it all the same.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("runs/demo")
    """Directory for data, runs, report.html and summary.json; the same command again goes on where it stopped."""
    steps: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Updates for each method; without it, as many as it takes to see the difference."""
    workers: Annotated[int | None, tyro.conf.arg(metavar="INT")] = None
    """Methods trained at the same time; without it, one for each core."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(DemoOptions, arguments, "demo")
    if options.out.is_dir():
        kinds = {"report.html": PAGE, "maze.png": PICTURE, "summary.json": DEMO_SUMMARY, "pointmaze-stitch.h5": DATASET}
        check_outputs({name: (options.out / name, kind) for name, kind in kinds.items()}, [])

    from odaf.studies import demo

    with repeatable():
        demo.run(options.out, options.steps or demo.STEPS, options.workers)
