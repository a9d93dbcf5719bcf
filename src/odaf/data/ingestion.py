"""From a log to a data set that carries its report."""

from collections.abc import Mapping, Sequence

from odaf.data.checks.findings import Finding, Report
from odaf.data.checks.run import check_log
from odaf.data.dataset import Dataset
from odaf.data.log import Log
from odaf.data.progress import Progress
from odaf.errors import ConfigError

# Errors in rows that no data set can hold, each with what to do in place of accepting it.
NEVER_HELD: dict[str, str] = {
    "field-missing": "name the column",
    "length-mismatch": "give every column one entry a row",
    "no-rows": "record some",
    "wrong-shape": "give one row a step",
    "wrong-width": "name each column once",
    "not-numbers": "convert the columns to numbers",
    "not-finite": 'repair the rows, or leave them out: on_missing="break" does so in tables and cuts the episode there',
    "too-large": "change the unit",
    "far-from-zero": "subtract a constant at the source, or leave the column out",
    "flag-values": "derive flags that are true or false",
    "constant-dimension": "give action_bounds=, or leave the column out",
    "action-bounds": "give action_bounds= with low below high",
    "actions-outside-bounds": "give the true action_bounds=, or clip the actions before",
    "no-episode-end": "name the column that tells episodes apart",
    "episode-ids-apart": "sort the rows by episode and time, or use unique ids",
    "flag-inside-episode": "correct the ids, or leave the id column out to split at the flags",
}


def refuse_hopeless(accept: Sequence[str]) -> None:
    """Raises `ConfigError` where accepting a check's errors cannot help, because no data set can hold such rows."""
    for name in accept:
        if name in NEVER_HELD:
            raise ConfigError(
                f"accept: {name}: no data set can hold such rows, so accepting them does not help; {NEVER_HELD[name]}"
            )


def ingest(log: Log, *, accept: Sequence[str] = (), progress: Progress | None = None) -> tuple[Dataset, Report]:
    """Checks a log and makes a data set of it, which keeps the report under `provenance["validation"]`.

    Args:
        log: what a reader returned.
        accept: names of checks whose errors are accepted: judgements about the task, such as `actions-discrete`.
        progress: as `check_log` takes it.

    Raises:
        ConfigError: accepting one of these checks cannot help.
        DatasetError: the report has errors that are not accepted, or the rows cannot be held as a data set.
    """
    refuse_hopeless(accept)
    report = check_log(log, progress=progress)
    report.require_usable(accept)
    dataset = Dataset.from_log(log)
    content = report.to_dict()
    validation = {"verdict": report.verdict(), "findings": content["findings"], "accepted": list(accept)}
    return dataset.with_provenance(validation=validation), report


def stored_report(dataset: Dataset) -> tuple[Report, tuple[str, ...]] | None:
    """The report that `ingest` left in a data set, and the checks whose errors were accepted; None where there is none.

    Its rows are numbered as in the source of that time. What is in `provenance["findings"]` too is left out.
    """
    validation = dataset.provenance.get("validation")
    if not isinstance(validation, Mapping):
        return None
    recorded = {str(entry.get("message")) for entry in dataset.provenance.get("findings", ())}
    findings = [Finding(**{**entry, "rows": tuple(entry["rows"])}) for entry in validation["findings"]]
    report = Report(
        source=str(dataset.provenance.get("file", "the source")),
        format=str(dataset.provenance.get("format", "unknown")),
        findings=tuple(finding for finding in findings if finding.message not in recorded),
    )
    return report, tuple(validation["accepted"])
