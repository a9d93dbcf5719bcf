"""Assembles the page of an assessment: the verdict first, then what it rests on."""

import json
from pathlib import Path

import jinja2

import odaf
from odaf.assessment import pictures
from odaf.assessment.after import Aftermath
from odaf.assessment.assess import Assessment
from odaf.data.writing import write_atomically
from odaf.errors import ConfigError
from odaf.report.drawing import DARK, LIGHT, plain_number
from odaf.report.svg import variables


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
    if out.is_dir():
        raise ConfigError(f"{out}: is a folder; name the HTML file to write, for example {out / 'assess.html'}")
    page = render(found, title, after)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(out, lambda file: file.write(page.encode("utf-8")))
    return out


def render(found: Assessment, title: str, after: Aftermath | None) -> str:
    """The whole page as text. Everything that comes from files is escaped by the template."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("odaf.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["figure"] = plain_number
    return environment.get_template("assess.html").render(
        title=title,
        light=variables(LIGHT),
        dark=variables(DARK),
        version=odaf.__version__,
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
