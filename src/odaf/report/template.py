"""How every page is made from its template and written: one file that needs no network, no script and no other file."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jinja2

import odaf
from odaf.data.writing import write_atomically
from odaf.errors import ConfigError
from odaf.report.drawing import DARK, LIGHT
from odaf.report.svg import variables


def rendered(template: str, filters: Mapping[str, Callable[..., Any]], **context: Any) -> str:
    """A page as text. Everything that comes from files is escaped; colours and the version are there for all.

    Args:
        template: its name, such as "data.html".
        filters: functions that it formats numbers with, by name.
        **context: what it shows; a name that it asks for and that is not here is an error.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("odaf.report", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= filters
    return environment.get_template(template).render(
        light=variables(LIGHT), dark=variables(DARK), version=odaf.__version__, **context
    )


def require_file(out: Path, example: str) -> None:
    """Raises `ConfigError` where `out` is a folder, naming a file in it that could be written."""
    if out.is_dir():
        raise ConfigError(f"{out}: is a folder; name the HTML file to write, for example {out / example}")


def write_page(page: str, out: Path) -> Path:
    """Writes a page whole or not at all, makes its folder where it is missing, and returns `out`."""
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(out, lambda file: file.write(page.encode("utf-8")))
    return out
