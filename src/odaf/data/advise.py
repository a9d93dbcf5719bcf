"""Which method to begin with for a log, asked from Python."""

import os

from odaf.data.checks import Advice, Report, check_file
from odaf.data.dataset import Dataset
from odaf.data.progress import Progress
from odaf.errors import DatasetError


def advise(log: Dataset | str | os.PathLike[str], *, progress: Progress | None = None) -> Advice:
    """Which method to begin with for a log, from what the log shows; it takes a pass over the rows and trains nothing.

    `odaf.preset(advice.preset, **advice.settings)` is the learner that it names.

    Args:
        log: a data set, or a file of ours or of a layout that needs no options.
        progress: of a file, told how far the pass has come, in rows.

    Returns:
        Preset and settings, the reasons in numbers of the log (returns in units of its reward, shares of rows and
        episodes in [0, 1]), and what was measured on logs of this kind.

    Raises:
        DatasetError: the checks find errors, which come first.

    Sources:
        docs/choosing.md, and the records that it names.
    """
    if isinstance(log, Dataset):
        return advice_of(log.check(), "the data set")
    return advice_of(check_file(log, progress=progress), os.fspath(log))


def advice_of(report: Report, name: str) -> Advice:
    """The advice in a report.

    Raises:
        DatasetError: there is none, because the log has errors.
    """
    if report.advice is None:
        errors = report.of("error")
        first = f" (first: {errors[0].check}: {errors[0].message})" if errors else ""
        raise DatasetError(
            f"{name}: the checks find errors{first}, and without mending them no method is advised; see all with "
            "`odaf data check`, or name a preset"
        )
    return report.advice
