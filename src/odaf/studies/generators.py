"""The generators' study: is every locomotion set that we can record what its name says?

One JSON file a set under the results directory, and a table drawn from those files. Sets whose file is there and was
made with the policies shipped now are not recorded again; sets without a policy are listed as such.
"""

import json
import sys
import time
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from odaf.environments.locomotion_data import NAMES, generate, split_name
from odaf.environments.shipped_policies import shipped
from odaf.errors import ConfigError
from odaf.runs.workers import run_jobs
from odaf.studies.ledger import LOCAL
from odaf.training.files import write_json

TRANSITIONS = 100_000
SEED = 0


def run(out: Path, workers: int = 1) -> None:
    """Record what is missing, then write the table.

    Args:
        out: directory of the records and `table.md`.
        workers: sets at the same time, each on its own core.
    """
    out.mkdir(parents=True, exist_ok=True)
    known = {name: policy_mark(name) for name in NAMES}
    missing = [name for name, mark in known.items() if mark is not None and not _is_current(out / f"{name}.json", mark)]
    print(f"{len(missing)} of {len(NAMES)} sets to record; records in {out}", file=sys.stderr)
    for (name, _), record in run_jobs(measure, [(name, out) for name in missing], workers):
        verdict = {True: "accepted", False: "not accepted", None: "unknown"}[record["acceptance"]["passed"]]
        print(f"{name}: {verdict}, {record['transitions_per_second']:,.0f} transitions/s", file=sys.stderr)
    records = {name: _read(out / f"{name}.json") for name in NAMES if known[name] is not None}
    (out / "table.md").write_text(table(records), encoding="utf-8")


def measure(job: tuple[str, Path]) -> dict[str, Any]:
    """Record one set and write its figures."""
    name, out = job
    began, used = time.monotonic(), time.process_time()
    dataset = generate(name, TRANSITIONS, SEED)
    seconds, processor_seconds = time.monotonic() - began, time.process_time() - used
    record = {
        "study": "generators",
        "origin": LOCAL,
        "command": "odaf reproduce generators",
        "same_set": f"odaf data generate {name} --transitions {TRANSITIONS} --seed {SEED} --out FILE",
        "policies_sha256": policy_mark(name),
        "sha256": dataset.fingerprint(),
        "seconds": seconds,
        "processor_seconds": processor_seconds,
        "transitions_per_second": TRANSITIONS / seconds,
        **{key: dataset.provenance[key] for key in ("name", "seed", "environment", "policies", "versions")},
        **{key: dataset.provenance[key] for key in ("statistics", "acceptance", "findings")},
    }
    write_json(out / f"{name}.json", record)
    return record


def policy_mark(name: str) -> str | None:
    """A fingerprint of what plays in a set: the task's page of facts; None where it cannot be recorded yet."""
    task, kind = split_name(name)
    if kind == "random":
        return "none"
    try:
        policies = shipped(task)
    except ConfigError:
        return None
    needed = {"medium-replay": [policies.replay], "medium-expert": [policies.medium, policies.expert]}
    if not all(needed.get(kind, [getattr(policies, kind, None)])):
        return None
    return sha256(json.dumps(policies.facts, sort_keys=True).encode()).hexdigest()


def table(records: Mapping[str, Mapping[str, Any]]) -> str:
    """Markdown table: a row a set, what its episodes earn beside what the published set's do."""
    lines = [
        f"Sets recorded by our own policies: {LOCAL}, {TRANSITIONS:,} transitions each. Scores are normalised, 0 for a",
        "random policy and 100 for an expert, and belong to the environment named; the raw return stands beside them.",
        "Limits are the published set's mean within 3 points (8 for medium-replay), for each half of medium-expert on",
        "its own. Speeds are by the clock, on a machine that may be busy with other work, and by processor time.",
        "Made by `odaf reproduce generators` from the records in this folder.",
        "",
        "| set | environment | whole episodes | return | score | expected | falls a row | accepted | transitions/s "
        "| by processor time |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name in NAMES:
        if name not in records:
            lines.append(f"| {name} | | | | | | | no policy shipped | | |")
            continue
        record = records[name]
        for part, figures in (record["statistics"].get("parts") or {"": record["statistics"]}).items():
            lines.append(_row(name, part, figures, record))
    missing = [name for name in NAMES if name in records and records[name]["acceptance"]["passed"] is not True]
    if missing:
        lines += ["", "Not accepted, check by check:", ""]
        for name in missing:
            lines += [f"- `{name}`: {finding['message']}" for finding in records[name]["findings"]]
    return "\n".join(lines) + "\n"


def _row(name: str, part: str, figures: Mapping[str, Any], record: Mapping[str, Any]) -> str:
    prefix = f"{part}/" if part else ""
    checks = [check for check in record["acceptance"]["checks"] if check["figure"].startswith(prefix)]
    score = next((check for check in checks if check["figure"] == f"{prefix}normalised_mean"), None)
    title = f"{name}, {part} half" if part else name
    if score is None:
        return f"| {title} | {record['environment']['id']} | 0 | | | | | unknown | | |"
    passed = "yes" if all(check["passed"] for check in checks) else "no"
    return (
        f"| {title} | {figures['environment']} | {figures['whole_episodes']:,} "
        f"| {figures['mean']:,.1f} ± {figures['std']:,.1f} | {figures['normalised_mean']:.1f} "
        f"| {score['lowest']:.1f} to {score['highest']:.1f} | {figures['terminal_row_share']:.4f} "
        f"| {passed} | {record['transitions_per_second']:,.0f} | {TRANSITIONS / record['processor_seconds']:,.0f} |"
    )


def _is_current(path: Path, mark: str) -> bool:
    return path.exists() and _read(path)["policies_sha256"] == mark


def _read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))
