"""Assembles the page of an assessment: the verdict first, then what it rests on."""

import json
from pathlib import Path

from odaf.assessment import pictures
from odaf.assessment.after import Aftermath
from odaf.assessment.assess import Assessment
from odaf.report.drawing import plain_number
from odaf.report.template import rendered, require_file, write_page


def build(found: Assessment, out: Path, title: str, after: Aftermath | None = None) -> Path:
    """Writes one HTML file that needs no network, no script and no other file.

    Args:
        found: what to show.
        out: the file to write; its folder is made when missing.
        title: heading of the page.
        after: what happened once the policy ran.

    Returns:
        `out`.

    Raises:
        ConfigError: `out` is a folder.
    """
    out = Path(out)
    require_file(out, "assess.html")
    page = render(found, title, after)
    return write_page(page, out)


def render(found: Assessment, title: str, after: Aftermath | None) -> str:
    """The whole page as text. Everything that comes from files is escaped by the template."""
    return rendered(
        "assess.html",
        {"figure": plain_number},
        title=title,
        found=found,
        after=after,
        samples=pictures.samples(found.holdout),
        values=pictures.values_chart(found, after),
        actions=pictures.action_charts(found),
        most_actions=pictures.MOST_ACTIONS,
        coverage=pictures.coverage_chart(found),
        over_time=pictures.guard_chart(found),
        drift=None if after is None else pictures.drift_chart(after),
        provenance=json.dumps(found.to_dict()["value"]["policy"], indent=2, ensure_ascii=False),
    )
