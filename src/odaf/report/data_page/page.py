"""Assembles the page about a data set."""

import json
from pathlib import Path

from odaf.data import Dataset
from odaf.report.data_page import pictures
from odaf.report.data_page.signs import sign_charts
from odaf.report.drawing import plain_number
from odaf.report.template import rendered, require_file, write_page


def build(dataset: Dataset, out: Path, title: str) -> Path:
    """See `odaf.report.data_page.build`."""
    out = Path(out)
    require_file(out, "data.html")
    page = render(dataset, title)
    return write_page(page, out)


def render(dataset: Dataset, title: str) -> str:
    """The whole page as text. Everything that comes from files is escaped by the template."""
    report = dataset.check()
    return rendered(
        "data.html",
        {"figure": plain_number},
        title=title,
        summary=dataset.summary(),
        report=report,
        signs=sign_charts(dataset, report.signs),
        returns=pictures.returns_chart(dataset),
        lengths=pictures.lengths_chart(dataset),
        coverage=pictures.coverage_chart(dataset),
        maze=pictures.maze_chart(dataset),
        actions=pictures.action_charts(dataset),
        most_actions=pictures.MOST_ACTIONS,
        sha256=dataset.fingerprint(),
        provenance=json.dumps(dataset.provenance, indent=2, ensure_ascii=False),
    )
