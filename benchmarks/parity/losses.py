"""Losses and gradients of both sides from equal weights, on one batch, with equal random numbers."""

import json
import os
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.parity.ours import compared

EXPORTS = Path(__file__).with_name("exports")
RECORD = Path(__file__).with_name("losses.json")
ROOT = Path(__file__).resolve().parents[2]
TOLERANCE = 1e-5  # of a difference, in units of the largest entry of its array

DELAY = "actor and slow copies: theirs step at updates 1, 3, 5, ours at 2, 4, 6; compared at one that is due"
DECODER = "the flag of d3rlpy 2.8.1's decoder is turned round; compared with it put right. As it is, "
DIFFERENCES: dict[str, tuple[str, ...]] = {
    "behaviour-cloning": (),
    "td3-bc": (DELAY,),
    "iql": (
        "order: theirs takes the gradients of V and Q together, so that Q's target holds V before its step; ours has V "
        "first, as the released code",
        "log std: theirs is -5 + 7 sigmoid(parameter), ours the parameter itself, clipped to the same range",
        "logged actions: ours are cut to plus or minus (1 - 1e-5)",
    ),
    "rebrac": (
        DELAY,
        "norm of the critics' layers: theirs none unless asked for, and then after the activation, ours before it; "
        "compared with it before",
        "rows whose successor has no logged action: ours go without the penalty, theirs are not drawn",
    ),
    "cql": (
        "the target's action: theirs is the policy's mode, ours a draw, as in the public codes; compared with a draw "
        "without noise",
        "temperature: theirs descends alpha (log pi + H), ours log alpha (log pi + H), with a slope in log alpha that "
        "is theirs over alpha; compared so",
        "order: theirs steps critics, then temperature, then the actor by both; ours takes all from equal parameters",
        "log std: ours is m output + c with learnt m and c; compared without",
    ),
    "bcq": (
        f"auto-encoder: {DECODER}it learns and is asked without its tanh",
        "number of actions: theirs is one, for the target and for acting; ours are two, as in the released code",
    ),
    "bear": (
        f"auto-encoder: {DECODER}it learns without its tanh, and the discrepancy sees the log after it and the actor "
        "before it",
        "actor: in d3rlpy 2.8.1 the multiplier's backward pass leaves minus the discrepancy's slope in the actor's, "
        "where it cancels the discrepancy's own; compared with that wiped out",
        "entropy: theirs is soft actor-critic's with a learnt temperature; compared at a temperature of 1e-30",
        "the actor's value: theirs is of a draw of its own, ours of the first of the discrepancy's; compared with one "
        "for both",
        "multiplier: theirs steps at the actor's rate, whatever is set, and not in the warm-up; ours at its own, from "
        "the start",
        "log std: theirs from -20, ours from -5",
    ),
}


def export(name: str, python: Path) -> None:
    """Writes what d3rlpy makes of one update."""
    command = [python, "-m", "benchmarks.parity.peer", "export", "--learner", name, "--out", EXPORTS / f"{name}.npz"]
    subprocess.run(command, check=True, cwd=ROOT, env={**os.environ, "OMP_NUM_THREADS": "1"}, capture_output=True)


def difference(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Largest difference of two arrays, in units of the largest entry of theirs; as it is where all of theirs are 0."""
    ours, theirs = np.asarray(ours, np.float64), np.asarray(theirs, np.float64)
    if ours.shape != theirs.shape:
        raise ValueError(f"shapes {ours.shape} and {theirs.shape} differ")
    return float(np.max(np.abs(ours - theirs)) / (np.max(np.abs(theirs)) or 1.0))


def compare(name: str) -> dict[str, Any]:
    """The largest difference of each loss, gradient and slow copy, from the export that is there."""
    with np.load(EXPORTS / f"{name}.npz", allow_pickle=False) as file:
        arrays = {key: file[key] for key in file.files}
    both = compared(name, arrays)
    if both.ours.keys() != both.theirs.keys():
        raise ValueError(f"{name}: not the same numbers on both sides: {both.ours.keys() ^ both.theirs.keys()}")
    by_part: dict[str, float] = {}
    for key, theirs in both.theirs.items():
        part = key.partition(".")[0].partition("[")[0]
        by_part[part] = max(by_part.get(part, 0.0), difference(both.ours[key], theirs))
    losses = {key: float(value) for key, value in both.theirs.items() if key.startswith("loss")}
    return {
        "peer": json.loads(arrays["about"].tobytes())["peer"],
        "largest_difference": by_part,
        "losses": losses,
        "numbers_compared": sum(int(np.size(value)) for value in both.theirs.values()),
        "differs_on_purpose": list(DIFFERENCES[name]),
    }


def main(names: Sequence[str], python: Path | None) -> int:
    """Prints the table and writes it down; the number of learners that differ by more than `TOLERANCE`."""
    record = json.loads(RECORD.read_text()) if RECORD.exists() else {}
    print(f"{'':20} {'part':24} {'loss':>12} {'largest difference':>20}")
    failed = 0
    for name in names:
        if python is not None:
            export(name, python)
        found = record[name] = compare(name)
        for part, value in found["largest_difference"].items():
            loss = found["losses"].get(part)
            shown = "" if loss is None else f"{loss:.6f}"
            print(f"{name:20} {part:24} {shown:>12} {value:20.1e}{'' if value <= TOLERANCE else '  too large'}")
        for sentence in found["differs_on_purpose"]:
            print(f"{'':20} on purpose: {sentence}")
        failed += max(found["largest_difference"].values()) > TOLERANCE
    RECORD.write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return failed
