"""A quick subset of benchmarks/check_faults.py: sound logs of many kinds pass, and each planted fault is named.

Seeds are neither those that thresholds were chosen with nor those of the table in docs/results/check-evidence.md.
"""

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT))

from benchmarks.faults.planted import FAULTS, KINDS, as_log  # noqa: E402

from odaf.data.checks import check_log  # noqa: E402


def _able(fault: str) -> list[str]:
    return [name for name in KINDS if name not in FAULTS[fault].not_in]


SEED = 900
JUDGED = {check for fault in FAULTS.values() for check in fault.checks}
SOUND = [name for place, name in enumerate(KINDS) if place % 3 == 0]
# One size of each fault, each in another kind, so that nearly all kinds take part; the benchmark judges all.
PLANTED = [
    (fault, list(FAULTS[fault].sizes)[place % len(FAULTS[fault].sizes)], _able(fault)[(7 * place + 3) % 24])
    for place, fault in enumerate(FAULTS)
]


@pytest.mark.parametrize("kind", SOUND)
def test_a_sound_log_is_not_blamed(kind: str):
    report = check_log(as_log(KINDS[kind].make(SEED), successors=True))
    assert not {finding.check for finding in report.findings if finding.severity != "note"} & JUDGED


@pytest.mark.parametrize(("fault", "size", "kind"), PLANTED)
def test_a_planted_fault_is_named(fault: str, size: str, kind: str):
    log = FAULTS[fault].sizes[size](KINDS[kind], SEED)
    if log is None:
        pytest.skip("this kind cannot have the fault")
    found = [finding for finding in check_log(log).findings if finding.check in FAULTS[fault].checks]
    assert found
    assert found[0].remedy and found[0].message
