"""Can this log be learned from? Every check passes over the rows once, block by block, and changes nothing.

`check_log` judges what a reader returns, `check_file` whatever is in a file, `Dataset.check` data in memory. What each
finding means for learning is told in docs/reference/checks.md.
"""

from odaf.data.checks.advice import Advice
from odaf.data.checks.findings import Finding, Report
from odaf.data.checks.run import check_file, check_log, open_log

__all__ = ["Advice", "Finding", "Report", "check_file", "check_log", "open_log"]
