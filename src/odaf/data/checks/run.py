"""Runs every check over a log in one pass."""

import math
import os
from dataclasses import replace
from typing import Any

import numpy as np

from odaf.data.checks import known, signs, structure
from odaf.data.checks.actions import Bounds, Discrete
from odaf.data.checks.advice import Advice, advice_for
from odaf.data.checks.continuity import Jumps, Successors
from odaf.data.checks.duplicates import Duplicates
from odaf.data.checks.episodes import Clock, Ends, Ids
from odaf.data.checks.findings import Finding, Report, sort_findings
from odaf.data.checks.log_statistics import measure
from odaf.data.checks.resets import MisplacedEnds
from odaf.data.checks.returns import Returns, RewardScale
from odaf.data.checks.sample import Sample, Sampler
from odaf.data.checks.stream import Check, Facts, blocks
from odaf.data.checks.values import Columns, Finite, FlagValues
from odaf.data.log import Log
from odaf.data.progress import Progress
from odaf.errors import DatasetError

BLOCK_BYTES = 2**23
"""Size of a block in the source's types. A block and its temporary copies are all the checks hold of the rows."""


def check_log(log: Log, *, widths: tuple[int, int] | None = None, progress: Progress | None = None) -> Report:
    """Everything the checks find in a log, in one pass over its rows.

    Memory does not grow with the log, but for 32 MB of hashes: where there are more different rows than these can
    hold, duplicates are counted in a share of them and the number is scaled up, which its message says.

    Args:
        log: what a reader returned.
        widths: (obs_dim, act_dim) that an environment needs; None takes those of the one the log names, if known.
        progress: told how far the pass has come, in rows.
    """
    facts, findings = structure.examine(log, widths)
    figures: dict[str, Any] = {}
    seen, advice = signs.Signs(), None
    if facts is not None and facts.fields:
        checks, sampler = _checks(facts), Sampler(facts)
        for block in blocks(facts, _block_rows(facts)):
            for check in (*checks, sampler):
                check.see(block)
            if progress is not None:
                progress(block.first + len(block), facts.rows)
        for check in checks:
            findings += check.findings()
        figures = _figures(facts, checks)
        names = _names(log.observation_names, "observation", facts.obs_dim)
        if (sample := sampler.sample()) is not None:
            seen = signs.find(sample)
            findings += seen.findings(names, facts.action_names)
        if not any(finding.severity == "error" for finding in findings):
            advice = _advice(facts, checks, sample, names)
    findings = [_as_in_source(log, finding) for finding in findings]
    findings += known.version_findings(log)
    findings += [_from_reader(entry) for entry in log.findings]
    return Report(log.source, log.format, sort_findings(findings), figures, seen, advice)


def check_file(
    path: str | os.PathLike[str],
    format: str | None = None,
    *,
    widths: tuple[int, int] | None = None,
    progress: Progress | None = None,
    **options: Any,
) -> Report:
    """Everything the checks find in a file; one that cannot be read at all has that as its only finding.

    Args:
        path: a file of ours or in any layout that `odaf.data.readers` knows.
        format: name of the layout; None tells it from the contents.
        widths: as `check_log` takes them.
        progress: as `check_log` takes it.
        options: of the layout's reader.
    """
    name = os.fspath(path)
    try:
        log = open_log(path, format, **options)
    except DatasetError as error:
        message, _, remedy = str(error).removeprefix(f"{name}: ").rpartition("; ")
        finding = Finding("unreadable", "error", "", 1, (), message or remedy, remedy)
        return Report(name, format or "unknown", (finding, *known.file_findings(path)))
    report = check_log(log, widths=widths, progress=progress)
    findings = sort_findings([*report.findings, *known.file_findings(path)])
    return replace(report, findings=findings)


def open_log(path: str | os.PathLike[str], format: str | None = None, **options: Any) -> Log:
    """The log in a file: one of ours, memory-mapped, or one in a layout that `odaf.data.readers` knows.

    Raises:
        DatasetError: the file cannot be read, or an option does not belong to its layout.
    """
    from odaf.data import storage

    if format in (None, "odaf") and (format == "odaf" or storage.is_own_file(path)):
        if options:
            raise DatasetError(
                f"{os.fspath(path)}: {next(iter(options))} applies to other layouts, this is an odaf dataset; "
                "leave the option out"
            )
        return storage.open_log(path)

    from odaf.data import readers

    return readers.read(path, format, **options)


def _checks(facts: Facts) -> list[Check]:
    """The checks that the log's columns allow, in the order in which their findings are shown."""
    has = facts.fields
    checks: list[Check] = [Finite(facts), FlagValues(facts)]
    if "actions" in has:
        checks += [Discrete(facts), Bounds(facts)]
    checks.append(Ends(facts))
    if "episode" in has:
        checks.append(Ids(facts))
    if "time" in has:
        checks.append(Clock(facts))
    if "observations" in has:
        checks += [Jumps(facts), MisplacedEnds(facts)]
    if "next_observations" in has and "observations" in has:
        checks.append(Successors(facts))
    checks += [Columns(facts), Duplicates(facts)]
    if "rewards" in has:
        checks += [RewardScale(facts), Returns(facts)]
    return checks


def _advice(facts: Facts, checks: list[Check], sample: Sample | None, names: tuple[str, ...]) -> Advice | None:
    """For a log without errors, in which all columns are there and finite."""
    returns = next(check for check in checks if isinstance(check, Returns))
    columns = next(check for check in checks if isinstance(check, Columns))
    episodes = returns.episodes()
    if not np.isfinite(episodes).all():  # sums of rewards beyond double precision
        return None
    variance = float(columns.moments["rewards"].std[0]) ** 2
    mixed = facts.log.mixture is not None
    return advice_for(measure(episodes, variance, facts.rows, names, facts.act_dim, sample, mixed))


def _names(given: tuple[str, ...] | None, prefix: str, count: int) -> tuple[str, ...]:
    return given if given is not None and len(given) == count else tuple(f"{prefix}_{i}" for i in range(count))


def _block_rows(facts: Facts) -> int:
    width = 0
    for name in facts.fields:
        column = facts.log.columns[name]
        width += getattr(column.dtype, "itemsize", 8) * (column.shape[1] if len(column.shape) > 1 else 1)
    return max(256, min(65_536, BLOCK_BYTES // max(width, 1)))


def _figures(facts: Facts, checks: list[Check]) -> dict[str, Any]:
    figures: dict[str, Any] = {"transitions": facts.rows, "obs_dim": facts.obs_dim, "act_dim": facts.act_dim}
    for check in checks:
        if isinstance(check, Ends):
            figures["episodes"] = check.episodes
        if isinstance(check, Returns):
            check.finish()
            for name, moments in (("return", check.returns), ("length", check.lengths)):
                if moments.count:
                    figures[f"mean_{name}"], figures[f"std_{name}"] = _plain(moments.mean)[0], _plain(moments.std)[0]
                    figures[f"lowest_{name}"], figures[f"highest_{name}"] = (
                        _plain(moments.low)[0],
                        _plain(moments.high)[0],
                    )
        if isinstance(check, Columns):
            for name, moments in check.moments.items():
                figures[name] = {
                    "mean": _plain(moments.mean),
                    "std": _plain(moments.std),
                    "low": _plain(moments.low),
                    "high": _plain(moments.high),
                }
    return figures


def _plain(values: np.ndarray) -> list[float | None]:
    """JSON numbers; None for what is not finite."""
    return [value if math.isfinite(value) else None for value in map(float, values)]


def _as_in_source(log: Log, finding: Finding) -> Finding:
    """The finding with its rows, which checks count from 0, numbered as the source numbers them."""
    numbers = log.row_numbers
    if numbers is None:
        return finding
    # A column that is longer than the log has rows that the source's numbering does not reach.
    return replace(finding, rows=tuple(int(numbers[row]) for row in finding.rows if row < len(numbers)))


def _from_reader(entry: Any) -> Finding:
    """What a reader or an earlier import had to decide, as a note."""
    count = entry.get("count")
    return Finding(
        str(entry.get("finding", "recorded")), "note", "", count if isinstance(count, int) else 1, (),
        str(entry.get("message", "")), "recorded when the data were read; nothing to do",
    )  # fmt: skip
