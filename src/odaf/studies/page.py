"""One HTML page of a study, drawn from its ledger: verdict, figures, tables, protocol, seeds and command."""

import base64
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from odaf.errors import ConfigError
from odaf.studies.job import Record
from odaf.studies.ledger import Ledger


@dataclass(frozen=True)
class Block:
    """A piece of Markdown as the tables of studies are written in.

    Attributes:
        kind: "text", "list" or "table".
        lines: of a text joined to one; of a list its entries; of a table its rows, cells joined by tabs.
    """

    kind: str
    lines: tuple[str, ...]

    @property
    def rows(self) -> list[list[str]]:
        """Cells of a table; the first row is its head."""
        return [line.split("\t") for line in self.lines]


def build(ledger: Ledger, out: Path, command: str) -> str:
    """Writes the page and returns the verdict in words.

    Args:
        ledger: of the study.
        out: the file to write; its folder is made when missing.
        command: what measures the study.

    Raises:
        ConfigError: `out` is a folder, or no record counts.
    """
    from odaf.report.template import rendered, require_file, write_page

    require_file(out, "study.html")
    study, records = ledger.study, ledger.held()
    if not records:
        raise ConfigError(f"{ledger.out}: holds no record that counts; measure some with `{command}`")
    said = "decides no claim" if study.claim is None else str(study.claim.verdict(records))
    found = rendered(
        "study.html",
        {},
        title=study.name,
        summary=study.summary,
        verdict=said,
        claim=study.claim,
        reasons=() if study.claim is None else study.claim.verdict(records).reasons,
        pictures=list(_pictures(ledger, records)),
        tables=[list(blocks(table(records))) for name, table in study.tables.items() if name.endswith(".md")],
        command=command,
        seeds=_seeds(records),
        records=len(records),
        jobs=len(study.jobs()),
        logs=sorted(ledger.data),
    )
    write_page(found, out)
    return said


def blocks(markdown: str) -> Iterator[Block]:
    """The pieces of a study's table file. Bold and code marks go; nothing else of Markdown is known."""
    kind, lines = "text", list[str]()

    def ended() -> Iterator[Block]:
        if lines:
            yield Block(kind, (" ".join(lines),) if kind == "text" else tuple(lines))
            lines.clear()

    for line in [*markdown.replace("**", "").replace("`", "").splitlines(), ""]:
        now = "table" if line.startswith("|") else "list" if line.startswith("- ") else "text"
        if now != kind or not line.strip():
            yield from ended()
            kind = now
        if now == "table" and not set(line) <= set("|-: "):
            cells = line.strip().strip("|").replace("\\|", "\0").split("|")
            lines.append("\t".join(cell.strip().replace("\0", "|") for cell in cells))
        elif now != "table" and line.strip():
            lines.append(line.removeprefix("- ") if now == "list" else line)
    yield from ended()


def _pictures(ledger: Ledger, records: Sequence[Record]) -> Iterator[str]:
    """The study's figures as data that stand in the page."""
    with tempfile.TemporaryDirectory() as folder:
        for name, draw in ledger.study.figures.items():
            path = Path(folder) / name
            draw(records, path)
            if path.exists():
                yield f"data:image/png;base64,{base64.b64encode(path.read_bytes()).decode()}"


def _seeds(records: Sequence[Record]) -> str:
    seeds = sorted({one["seed"] for one in records if isinstance(one.get("seed"), int)})
    return ", ".join(map(str, seeds)) or "see the tables"
