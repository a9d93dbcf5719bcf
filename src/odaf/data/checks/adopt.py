"""From a log to a data set that carries its report."""

from collections.abc import Sequence

from odaf.data.checks.findings import Report
from odaf.data.checks.run import Progress, check_log
from odaf.data.dataset import Dataset
from odaf.data.log import Log


def adopt(log: Log, *, accept: Sequence[str] = (), progress: Progress | None = None) -> tuple[Dataset, Report]:
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
    dataset = log.to_dataset()
    content = report.to_dict()
    validation = {"verdict": report.verdict(), "findings": content["findings"], "accepted": list(accept)}
    return dataset.with_provenance(validation=validation), report
