"""From a log to a data set that carries its report."""

from collections.abc import Mapping, Sequence

from odaf.data.checks.findings import Finding, Report
from odaf.data.checks.run import check_log
from odaf.data.dataset import Dataset
from odaf.data.log import Log
from odaf.data.progress import Progress


def ingest(log: Log, *, accept: Sequence[str] = (), progress: Progress | None = None) -> tuple[Dataset, Report]:
    """Checks a log and makes a data set of it, which keeps the report under `provenance["validation"]`.

    Args:
        log: what a reader returned.
        accept: names of checks whose errors are accepted; columns that cannot be held are refused all the same.
        progress: as `check_log` takes it.

    Raises:
        DatasetError: the report has errors that are not accepted, or the rows cannot be held as a data set.
    """
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
