"""One self-contained page about one or more runs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from odaf.report.extras import check_extra

__all__ = ["build"]

Format = Literal["html", "csv", "json", "latex"]


def build(
    run_directories: Sequence[Path],
    out: Path,
    title: str | None = None,
    *,
    names: Sequence[str] | None = None,
    format: Format = "html",
) -> Path:
    """Writes one HTML file about the runs: it needs no network, no script and no other file. Or its table as data.

    The page is written whole or not at all. What a run lacks (an evaluation, a seed that has not finished) is named at
    the top of the page; what no run has (a maze, a rate of success) leaves neither a section nor a column.

    Args:
        run_directories: run directories, or folders that hold some; shown in this order.
        out: the file to write; its folder is made when missing.
        title: heading of the page, or first words of the LaTeX table's caption; `None` names the methods.
        names: what to call the runs, one name each; `None` takes the methods and what differs between them.
        format: "html" is the page; "csv", "json" and "latex" are its table of scores, a row a run. JSON holds every
            seed's mean and every episode's return beside it.

    Returns:
        `out`.

    Raises:
        ConfigError: a path is no run directory, `out` is a folder, `names` do not fit the runs, or the `report` extra
            is not installed.
        CheckpointError: a file of a run is damaged.
    """
    if format != "html":
        from odaf.report import export

        return export.write(run_directories, out, format, title, names)
    check_extra()
    from odaf.report import page  # needs the extra

    return page.build(run_directories, out, title, names)
