"""One self-contained page about one data set: returns, lengths, the ground it covers, its actions."""

from pathlib import Path
from typing import TYPE_CHECKING

from odaf.report.extras import check_extra

if TYPE_CHECKING:
    from odaf.data import Dataset

__all__ = ["build", "check_extra"]


def build(dataset: "Dataset", out: Path, title: str) -> Path:
    """Writes one HTML file that needs no network, no script and no other file.

    Args:
        dataset: what to draw.
        out: the file to write; its folder is made when missing.
        title: heading of the page.

    Returns:
        `out`.

    Raises:
        ConfigError: `out` is a folder, or the `report` extra is not installed.
    """
    check_extra()
    from odaf.report.data_page import page  # needs the extra

    return page.build(dataset, out, title)
