"""What a check has to say, and all of it together: printed for people, as JSON for programs."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from odaf.errors import DatasetError

if TYPE_CHECKING:
    from rich.console import Group

Severity = Literal["error", "warning", "note"]
SEVERITIES: tuple[Severity, ...] = ("error", "warning", "note")
SHOWN_ROWS = 5


@dataclass(frozen=True)
class Finding:
    """One thing that a check noticed.

    Attributes:
        check: name of the check, such as `not-finite`; docs/reference/checks.md has a paragraph on each.
        severity: `error`: not usable as it is; `warning`: usable, but learning may suffer; `note`: good to know.
        field: the column it is about, empty for the whole log.
        count: how many rows (values, episodes, as the message says) it concerns.
        rows: the first rows, numbered as in the source; checks themselves count from 0.
        message: what was found.
        remedy: what to do about it.
    """

    check: str
    severity: Severity
    field: str
    count: int
    rows: tuple[int, ...]
    message: str
    remedy: str

    def __str__(self) -> str:
        place = f"field '{self.field}': " if self.field else ""
        rows = f" ({name_first(self.rows, self.count)})" if self.rows else ""
        return f"{place}{self.message}{rows}; {self.remedy}"


def name_first(rows: Sequence[int], count: int) -> str:
    """`row 7`, `rows 1, 2` or `rows 1, 2, ...` of `count` in all."""
    shown = ", ".join(f"{row}" for row in rows)
    return f"row {shown}" if count == 1 else f"rows {shown}" + (", ..." if count > len(rows) else "")


@dataclass(frozen=True)
class Report:
    """Everything the checks found in one log. Printing it shows a table; nothing was changed in the data.

    Attributes:
        source: how messages name the log, for instance a file name.
        format: the layout it was read from.
        findings: errors first, then warnings, then notes.
        figures: what was measured on the way, in JSON types: sizes, returns, range and spread of each column.
        signs: `odaf.data.checks.signs.Signs` of a sample of the rows, for pictures; None in a report from a file.
        advice: `odaf.data.checks.advice.Advice`, which method to begin with; None where there are errors, and in a
            report from a file.
    """

    source: str
    format: str
    findings: tuple[Finding, ...]
    figures: Mapping[str, Any] = field(default_factory=dict)
    signs: Any = field(default=None, repr=False, compare=False)
    advice: Any = field(default=None, repr=False, compare=False)

    def of(self, severity: Severity) -> tuple[Finding, ...]:
        """The findings of one severity."""
        return tuple(finding for finding in self.findings if finding.severity == severity)

    @property
    def usable(self) -> bool:
        """Whether no finding is an error."""
        return not self.of("error")

    def exit_code(self, strict: bool = False) -> int:
        """0 usable, 1 with warnings where `strict`, 2 with errors."""
        if not self.usable:
            return 2
        return 1 if strict and self.of("warning") else 0

    def require_usable(self, accept: Sequence[str] = ()) -> None:
        """Raises `DatasetError` with every error, except those of the checks named in `accept`."""
        left = [finding for finding in self.of("error") if finding.check not in accept]
        if left:
            raise DatasetError("\n".join(f"{self.source}: {finding}" for finding in left))

    def to_dict(self) -> dict[str, Any]:
        """JSON types: source, format, usable, counts by severity, findings, figures, advice (null with errors)."""
        return {
            "source": self.source,
            "format": self.format,
            "usable": self.usable,
            "counts": {severity: len(self.of(severity)) for severity in SEVERITIES},
            "findings": [asdict(finding) | {"rows": list(finding.rows)} for finding in self.findings],
            "figures": dict(self.figures),
            "advice": None if self.advice is None else self.advice.to_dict(),
        }

    def verdict(self) -> str:
        """One sentence: whether the log can be used."""
        errors, warnings = len(self.of("error")), len(self.of("warning"))
        if errors:
            return f"not usable as it is: {_plural(errors, 'error')}, {_plural(warnings, 'warning')}"
        return f"usable, with {_plural(warnings, 'warning')}" if warnings else "usable; nothing to complain about"

    def __rich__(self) -> "Group":
        from rich.console import Group
        from rich.table import Table
        from rich.text import Text

        size = ""
        if "transitions" in self.figures:
            size = f" · {self.figures['transitions']:,} rows, {_plural(self.figures.get('episodes', 0), 'episode')}"
        parts: list[Any] = [Text(f"{self.source} · {self.format}{size}", style="bold"), Text(self.verdict())]
        if self.findings:
            table = Table(box=None, padding=(0, 2, 0, 0), show_edge=False, header_style="dim")
            table.add_column("")
            table.add_column("check", no_wrap=True)
            table.add_column("field")
            table.add_column("count", justify="right")
            table.add_column("what it is, and what to do", ratio=1)
            for finding in self.findings:
                rows = f" ({name_first(finding.rows, finding.count)})" if finding.rows else ""
                style = {"error": "bold red", "warning": "yellow", "note": "dim"}[finding.severity]
                table.add_row(
                    Text(finding.severity, style=style),
                    Text(finding.check),
                    Text(finding.field),
                    f"{finding.count:,}",
                    Text(f"{finding.message}{rows}.\n-> {finding.remedy}"),
                )
            parts += [Text(""), table]
        return Group(*parts)

    def __str__(self) -> str:
        from rich.console import Console

        target = io.StringIO()
        Console(file=target, width=110, color_system=None, force_terminal=False).print(self)
        return "\n".join(line.rstrip() for line in target.getvalue().splitlines())


def sort_findings(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Errors first; otherwise the order in which the checks ran."""
    return tuple(sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity)))


def _plural(count: int, word: str) -> str:
    return f"{count:,} {word}" + ("" if count == 1 else "s")
