"""`odaf cite METHOD...`: what to cite for a method."""

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from odaf.cli.options import parse
from odaf.errors import ConfigError


@dataclass(frozen=True)
class CiteOptions:
    """Print the papers of a method: of its learner, of each of its terms, and this package itself.

    Lines before the entries say which paper is for which part; BibTeX reads them as comments.
    """

    methods: Annotated[
        tyro.conf.Positional[tuple[str, ...]],
        tyro.conf.arg(metavar="METHOD [METHOD ...]", help_behavior_hint="(at least one)"),
    ]
    """Presets (or files of them), learners, terms, run directories, or folders that hold such directories."""
    format: Literal["bibtex", "text"] = "bibtex"
    """Entries for a BibTeX file, or lines to read."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(CiteOptions, arguments, "cite")
    if not options.methods:
        raise ConfigError("name at least one method, as in `odaf cite odaf-rorl` or `odaf cite runs/maze`")

    from odaf.runs.citing import bibliography

    print(bibliography(options.methods, options.format))
