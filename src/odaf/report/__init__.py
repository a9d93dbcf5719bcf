"""One self-contained page about one or more runs."""

from collections.abc import Sequence
from pathlib import Path

from odaf.report.extras import check_extra

__all__ = ["build"]


def build(
    run_directories: Sequence[Path], out: Path, title: str | None = None, *, names: Sequence[str] | None = None
) -> Path:
    """Writes one HTML file about the runs: it needs no network, no script and no other file.

    The page is written whole or not at all. What a run lacks (an evaluation, a seed that has not finished) is named at
    the top of the page; what no run has (a maze, a rate of success) leaves neither a section nor a column.

    Args:
        run_directories: run directories, or folders that hold some; shown in this order.
        out: the file to write; its folder is made when missing.
        title: heading of the page; `None` names the methods.
        names: what to call the runs, one name each; `None` takes the methods and what differs between them.

    Returns:
        `out`.

    Raises:
        ConfigError: a path is no run directory, `out` is a folder, `names` do not fit the runs, or the `report` extra
            is not installed.
        CheckpointError: a file of a run is damaged.
    """
    check_extra()
    from odaf.report import page  # needs the extra

    return page.build(run_directories, out, title, names)
