"""Assembles the page about a data set."""

import json
from pathlib import Path

import jinja2

import odaf
from odaf.data import Dataset
from odaf.data.writing import write_atomically
from odaf.errors import ConfigError
from odaf.report.data_page import pictures
from odaf.report.data_page.signs import sign_charts
from odaf.report.drawing import DARK, LIGHT, plain_number
from odaf.report.svg import variables


def build(dataset: Dataset, out: Path, title: str) -> Path:
    """See `odaf.report.data_page.build`."""
    out = Path(out)
    if out.is_dir():
        raise ConfigError(f"{out}: is a folder; name the HTML file to write, for example {out / 'data.html'}")
    page = render(dataset, title)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(out, lambda file: file.write(page.encode("utf-8")))
    return out


def render(dataset: Dataset, title: str) -> str:
    """The whole page as text. Everything that comes from files is escaped by the template."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("odaf.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["figure"] = plain_number
    report = dataset.check()
    return environment.get_template("data.html").render(
        title=title,
        light=variables(LIGHT),
        dark=variables(DARK),
        version=odaf.__version__,
        summary=dataset.summary(),
        report=report,
        signs=sign_charts(dataset, report.signs),
        returns=pictures.returns_chart(dataset),
        lengths=pictures.lengths_chart(dataset),
        coverage=pictures.coverage_chart(dataset),
        actions=pictures.action_charts(dataset),
        most_actions=pictures.MOST_ACTIONS,
        sha256=dataset.fingerprint(),
        provenance=json.dumps(dataset.provenance, indent=2, ensure_ascii=False),
    )
