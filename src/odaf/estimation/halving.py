"""Successive halving without a simulator: a grid is trained a while, the worse half by an estimate is left, and so on.

With n runs there are K = ceil(log2 n) cuts. Before cut k every run that is left has made steps / 2^(K - k + 1) updates,
then the better half, rounded up, goes on; the last one makes all steps:

    runs left at k = 1 .. K + 1:  ceil( n / 2^(k - 1) ),   updates of each:  steps / 2^(K - k + 1)

(Jamieson and Talwalkar 2016.) Runs are compared by `odaf.estimation.select` of their last checkpoints on a hold-out:
the mean over the seeds of a run. What was decided stands in `halving.json` in the folder of the runs, so that the same
call goes on where it was stopped and decides nothing twice.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from odaf.algorithms import config
from odaf.components.fitting import Progress
from odaf.data.dataset import Dataset
from odaf.errors import CheckpointError, ConfigError
from odaf.estimation.select import RunWorth, Selection, select
from odaf.evaluation.runs import Run
from odaf.runs.fit import resume
from odaf.runs.many import Plan, fit_many
from odaf.training.files import plain, write_json
from odaf.training.fit import load_run
from odaf.training.logging import Logger
from odaf.training.progress import ProgressReport
from odaf.training.settings import RunSettings

FILE = "halving.json"


@dataclass(frozen=True)
class Rung:
    """What was decided after a number of updates.

    Attributes:
        steps: updates that every run had made.
        runs: names of the runs' folders with what they are worth, best first; `refused` where the log cannot tell.
        kept: names of those that go on; after the last rung the one that is chosen.
    """

    steps: int
    runs: tuple[RunWorth, ...]
    kept: tuple[str, ...]


@dataclass(frozen=True)
class Halving:
    """A finished search.

    Attributes:
        rungs: in order.
        best: the run that was trained to its end.
        selection: of its checkpoints, on the same hold-out.
    """

    rungs: tuple[Rung, ...]
    best: Run
    selection: Selection


def rungs_of(runs: int, steps: int) -> list[tuple[int, int]]:
    """How many runs are left, and the updates that each has made, at each rung; the last is the chosen run's end.

    Raises:
        ConfigError: there are too few steps to halve them so often.
    """
    cuts = math.ceil(math.log2(runs)) if runs > 1 else 0
    found = [(math.ceil(runs / 2**k), steps // 2 ** (cuts - k)) for k in range(cuts + 1)]
    if found[0][1] < 1:
        raise ConfigError(f"steps={steps} cannot be halved {cuts} times for {runs} runs; train for more steps")
    return found


def train_halving(
    runs: Sequence[Plan],
    holdout: Dataset,
    directory: Path,
    *,
    settings: RunSettings,
    method: str = "fqe",
    discount: float = 1.0,
    horizon: int | None = None,
    seed: int = 0,
    progress: bool | ProgressReport = True,
    estimating: Callable[[str], Progress] = lambda what: lambda done, total: None,
    loggers: Sequence[Logger] = (),
    say: Callable[[str], None] = lambda line: None,
    **changes: Any,
) -> Halving:
    """Trains a grid and culls it by estimate.

    Args:
        runs: of `combinations`, all in folders of `directory`.
        holdout: what estimates are made from; no run may learn from it.
        directory: the folder of all runs.
        settings: how each run is to go to its end.
        method: estimator that decides.
        discount: weight of a reward one step later.
        horizon: steps of an episode that are counted; None takes what the log shows.
        seed: of the estimates.
        progress: whether to show a progress bar while training.
        estimating: gives the progress of an estimate, by what is estimated.
        loggers: receivers of metrics.
        say: hears a line for each decision.
        **changes: fields of `EstimateSettings` by name.

    Raises:
        ConfigError: a setting is out of range, a run learns from the hold-out, or the folder holds another search.
        DivergenceError: a training diverged.
    """
    if any(plan.dataset.fingerprint() == holdout.fingerprint() for plan in runs):
        raise ConfigError(
            "halving: the hold-out is the log that a run learns from; set another aside: `odaf data split`"
        )
    plan_of_rungs = rungs_of(len(runs), settings.steps)
    names = {plan.directory.name: plan for plan in runs}
    identity = plain(
        {
            "runs": {name: config.to_dict(plan.algorithm) for name, plan in names.items()},
            "data": {name: plan.dataset.fingerprint() for name, plan in names.items()},
            "holdout": holdout.fingerprint(),
            "steps": settings.steps,
            "seeds": list(settings.seeds),
            "estimate": {"method": method, "discount": discount, "horizon": horizon, "seed": seed, **changes},
        }
    )
    decided = _decided(directory / FILE, identity)
    left = list(names) if not decided else list(decided[-1].kept)
    selection: Selection | None = None
    for number, (_, steps) in enumerate(plan_of_rungs):
        if number < len(decided):
            continue
        _train([names[name] for name in left], replace(settings, steps=steps), progress, loggers)
        selection = select(
            [names[name].directory for name in left],
            holdout,
            method=method,
            checkpoints="last",
            discount=discount,
            horizon=horizon,
            seed=seed,
            progress=estimating(f"estimating {len(left)} runs after {steps:,} updates"),
            **changes,
        )
        keep = plan_of_rungs[number + 1][0] if number + 1 < len(plan_of_rungs) else 1
        worths = tuple(replace(each, run=Path(each.run).name) for each in selection.runs)
        left = [each.run for each in worths[:keep]]
        decided.append(Rung(steps, worths, tuple(left)))
        directory.mkdir(parents=True, exist_ok=True)
        write_json(directory / FILE, {"identity": identity, "rungs": plain([asdict(rung) for rung in decided])})
        shown = ", ".join(f"{each.run} {each.worth:,.4g}{' (refused)' if each.refused else ''}" for each in worths)
        say(f"after {steps:,} updates: {shown}; goes on: {', '.join(left)}")
    best = names[left[0]]
    selection = select(
        best.directory,
        holdout,
        method=method,
        discount=discount,
        horizon=horizon,
        seed=seed,
        progress=estimating("estimating the checkpoints of the chosen run"),
        **changes,
    )
    return Halving(tuple(decided), Run(load_run(best.directory)), selection)


def _train(
    runs: Sequence[Plan], settings: RunSettings, progress: bool | ProgressReport, loggers: Sequence[Logger]
) -> None:
    """Brings every run to this many updates: those that are not begun together, others from where they stopped."""
    begun = [plan for plan in runs if (plan.directory / "config.json").exists()]
    longer = [plan for plan in begun if load_run(plan.directory).config["steps"] < settings.steps]
    same = [plan for plan in runs if plan not in longer]
    for plan in longer:
        resume(
            plan.directory,
            settings.steps,
            workers=settings.workers,
            dataset=plan.dataset,
            progress=progress,
            loggers=loggers,
        )
    if same:
        fit_many(same, settings=settings, progress=progress, loggers=loggers)


def _decided(path: Path, identity: Mapping[str, Any]) -> list[Rung]:
    """The rungs that an earlier call decided."""
    if not path.exists():
        return []
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        rungs = [
            Rung(rung["steps"], tuple(RunWorth(**each) for each in rung["runs"]), tuple(rung["kept"]))
            for rung in content["rungs"]
        ]
        earlier = content["identity"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CheckpointError(
            f"{path}: cannot be read ({type(error).__name__}: {error}); restore it, or search anew in another folder"
        ) from None
    differing = [name for name in identity if earlier.get(name) != identity[name]]
    if differing:
        raise ConfigError(
            f"{path}: is of a search with other {', '.join(differing)}; give the command as it was, or another folder "
            "with --out"
        )
    return rungs
