"""How often the checks of `odaf data check` name a fault that is there, and how often they blame a log that is sound.

Sound logs of many kinds (benchmarks/faults/sound.py) are made with each seed, and judged as they are and with each
fault planted at each of its sizes (benchmarks/faults/planted.py). With `--recorded`, sets of `odaf data generate` take
part; faults of the plant itself cannot be planted in these. Thresholds were chosen on seeds 0 to 9; judge with others.

    python benchmarks/check_faults.py --seeds 104 105 --recorded --markdown docs/results/check-evidence.md
"""

import argparse
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from benchmarks.faults.planted import ADVICE, FAULTS, Fault, as_log  # noqa: E402
from benchmarks.faults.recorded import RECORDED, Recorded  # noqa: E402
from benchmarks.faults.sound import KINDS, Kind  # noqa: E402
from benchmarks.machine import machine, write_figures  # noqa: E402
from odaf.data.checks import check_log, structure  # noqa: E402
from odaf.data.checks.returns import Returns  # noqa: E402
from odaf.data.checks.stream import blocks  # noqa: E402
from odaf.data.log import Log  # noqa: E402

BEGIN, END = "<!-- table by benchmarks/check_faults.py -->", "<!-- end of table -->"
BEGIN_ADVICE = "<!-- table by benchmarks/check_faults.py --advice -->"
Logs = dict[str, Kind | Recorded]


def judged(faults: Mapping[str, Fault]) -> list[str]:
    """Names of the findings that name one of these."""
    return sorted({check for fault in faults.values() for check in fault.checks})


def found_in(log: Log, faults: Mapping[str, Fault]) -> set[str]:
    """Names of the findings that are judged here: warnings and errors that are faults', or notes that advise."""
    if faults is ADVICE:  # all of it comes from one check, and the others take long
        facts, _ = structure.examine(log, None)
        assert facts is not None
        check = Returns(facts)
        for block in blocks(facts, 65_536):
            check.see(block)
        findings = check.findings()
    else:
        findings = [finding for finding in check_log(log).findings if finding.severity != "note"]
    return {finding.check for finding in findings} & set(judged(faults))


def logs_with(kinds: Logs, plant: Any, without: Any, seeds: Sequence[int]) -> Iterator[tuple[str, Log]]:
    """Each kind that can have the fault, with it."""
    for name, kind in kinds.items():
        if name in without:
            continue
        for seed in seeds if isinstance(kind, Kind) else seeds[:1]:
            try:
                log = plant(kind, seed)
            except NotImplementedError:  # a recorded set whose plant would have to be another
                continue
            if log is not None:
                yield name, log


def judge_planted(kinds: Logs, seeds: Sequence[int], faults: Mapping[str, Fault] = FAULTS) -> list[dict[str, Any]]:
    """A row for each fault and size: how many logs had it, in how many it was named, and where it was not."""
    rows = []
    for name, fault in faults.items():
        for size, plant in fault.sizes.items():
            count, missed = 0, Counter()
            for kind, log in logs_with(kinds, plant, fault.not_in, seeds):
                count += 1
                if not found_in(log, faults) & set(fault.checks):
                    missed[kind] += 1
            row = {"fault": name, "size": size, "checks": list(fault.checks), "logs": count}
            rows.append(row | {"found": count - missed.total(), "missed": dict(missed)})
            print(f"{name}, {size}: {row['logs'] - missed.total()} of {count}", file=sys.stderr, flush=True)
    return rows


def judge_sound(kinds: Logs, seeds: Sequence[int], faults: Mapping[str, Fault] = FAULTS) -> dict[str, Any]:
    """How many sound logs were looked at, and which were blamed by which finding."""
    blamed: dict[str, Counter[str]] = defaultdict(Counter)
    count = any_blamed = 0
    for name, kind in kinds.items():
        for seed in seeds if isinstance(kind, Kind) else seeds[:1]:
            rows = kind.make(seed)
            for successors in (False, True):
                found = found_in(as_log(rows, successors), faults)
                count += 1
                any_blamed += bool(found)
                for check in found:
                    blamed[check][name] += 1
    return {"logs": count, "blamed": any_blamed, "by_check": {check: dict(blamed[check]) for check in judged(faults)}}


def speed() -> dict[str, float]:
    """Seconds of the processor for a log of a million rows, 17 observations and 6 actions."""
    import numpy as np

    rng, rows = np.random.default_rng(0), 1_000_000
    columns = {
        "observations": rng.normal(size=(rows, 17)).astype(np.float32),
        "actions": rng.uniform(-1, 1, (rows, 6)).astype(np.float32),
        "rewards": rng.normal(size=rows).astype(np.float32),
        "episode": np.arange(rows) // 1_000,
    }
    began = time.process_time()
    check_log(Log(columns, "log", "csv", action_bounds=(-1.0, 1.0)))
    return {"rows": rows, "processor_seconds": time.process_time() - began}


def as_markdown(planted: list[dict[str, Any]], sound: dict[str, Any], seeds: Sequence[int]) -> str:
    """The tables that stand in docs/results/check-evidence.md."""
    lines = ["", f"Judged on seeds {', '.join(map(str, seeds))}: {sound['logs']:,} sound logs, "]
    lines[-1] += f"{sound['blamed']} of them blamed by any of these findings ({sound['blamed'] / sound['logs']:.1%})."
    lines += ["", "| fault | size | named by | found | not found in |", "|---|---|---|---|---|"]
    for row in planted:
        names = ", ".join(f"`{check}`" for check in row["checks"])
        missed = ", ".join(f"{kind} ({count})" if count > 1 else kind for kind, count in row["missed"].items())
        share = f"{row['found']} of {row['logs']} ({row['found'] / max(row['logs'], 1):.0%})"
        lines.append(f"| {row['fault']} | {row['size']} | {names} | {share} | {missed} |")
    lines += ["", "| finding | sound logs blamed | which |", "|---|---|---|"]
    for check, kinds in sound["by_check"].items():
        total = sum(kinds.values())
        lines.append(f"| `{check}` | {total} of {sound['logs']} ({total / sound['logs']:.1%}) | {', '.join(kinds)} |")
    return "\n".join([*lines, "", ""])


def main(arguments: Sequence[str] | None = None) -> None:
    """Judges, prints, and writes what was asked for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[100, 101])
    parser.add_argument("--kinds", type=int, default=len(KINDS), help="only so many kinds, for a quick look")
    parser.add_argument("--recorded", action="store_true", help="also sets of `odaf data generate`")
    parser.add_argument("--advice", action="store_true", help="judge the notes that advise, in place of faults")
    parser.add_argument("--json", type=Path, default=None)
    parser.add_argument("--markdown", type=Path, default=None, help="page whose table is written anew")
    options = parser.parse_args(arguments)
    kinds: Logs = dict(list(KINDS.items())[: options.kinds])
    if options.recorded:
        kinds |= RECORDED
    about = machine()
    faults = ADVICE if options.advice else FAULTS
    sound, planted = judge_sound(kinds, options.seeds, faults), judge_planted(kinds, options.seeds, faults)
    table = as_markdown(planted, sound, options.seeds)
    print(table)
    if options.markdown is not None:
        page = options.markdown.read_text(encoding="utf-8")
        head, begin, rest = page.partition(BEGIN_ADVICE if options.advice else BEGIN)
        options.markdown.write_text(head + begin + table + END + rest.partition(END)[2], encoding="utf-8")
    write_figures(options.json, about, {"seeds": options.seeds, "planted": planted, "sound": sound, "speed": speed()})


if __name__ == "__main__":
    main()
