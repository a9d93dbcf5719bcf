"""`odaf claims`: what the records of the studies say of the paper's claims."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from odaf.cli.options import parse
from odaf.cli.results import table


@dataclass(frozen=True)
class ClaimsOptions:
    """Say of each claim of the paper's whether the studies' records bear it out; measures nothing.

    A claim is held, not held, or not decided at the seeds that were measured; then the reasons say what is missing.
    Records that do not say what would be measured today do not count.
    """

    results: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results")
    """Folder of the ledgers; claims.json is written into it."""
    page: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("docs/claims.md")
    """Markdown file to write the claims to."""


def run(arguments: list[str]) -> None:
    """Entry point of the command."""
    options = parse(ClaimsOptions, arguments, "claims")
    from odaf.studies.claims import decided, write

    found = decided(options.results)
    write(found, options.results / "claims.json", options.page)
    rows = [[name, each.verdict.verdict, str(each.verdict.seeds)] for name, each in found.items()]
    print(table(["claim", "verdict", "seeds"], rows))
    print(f"\nThe tests, intervals and reasons are in {options.results / 'claims.json'} and {options.page}")
