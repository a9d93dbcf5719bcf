"""The true replay buffer of a training run up to its medium policy: what a published `medium-replay` set is."""

from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any

from odaf.behaviour.online import OnlineRun, curve_in, run_in, train
from odaf.behaviour.replay import Replay
from odaf.data.dataset import Dataset
from odaf.environments.contact_margins import ContactMargins
from odaf.environments.locomotion_acceptance import PUBLISHED
from odaf.environments.locomotion_data import judged, split_name
from odaf.errors import ConfigError
from odaf.training.progress import ProgressReport

EVALUATE_EVERY = 5_000
KIND = "medium-replay"


def exact_replay(
    name: str,
    directory: Path,
    seed: int = 0,
    version: str = "v4",
    progress: ProgressReport | None = None,
    contact_margins: ContactMargins | None = None,
) -> Dataset:
    """Every step of a training run until an evaluation first reaches the medium set's score.

    Args:
        name: a set of the kind medium-replay.
        directory: of the run; one that is there is gone on with, or only read if it has come far enough.
        seed: of a new run.
        version: of the environment.
        progress: hears how far the run is.
        contact_margins: how the simulator counts them, see `odaf.environments.contact_margins`; None is as the run in
            the directory did, or else as the installed one does.

    Raises:
        ConfigError: another kind of set, a run of another task, version or rule, or one that never got there.
    """
    task, kind = split_name(name, version)
    if kind != KIND:
        raise ConfigError(f"{name}: only {KIND} sets are the buffer of a training run; leave --exact out")
    there = (directory / "config.json").exists()
    new = OnlineRun(task.name, version, seed, evaluate_every=EVALUATE_EVERY, contact_margins=contact_margins)
    run = run_in(directory) if there else new
    if (run.task, run.version) != (task.name, version):
        raise ConfigError(f"{directory}: holds a run of {run.task}, {run.version}; name another place")
    if contact_margins not in (None, run.contact_margins):
        kept = run.contact_margins or "those of the MuJoCo that was installed"
        raise ConfigError(
            f"{directory}: holds a run with contact margins '{kept}', not '{contact_margins}'; name another place, or "
            "leave contact_margins out"
        )
    medium = PUBLISHED[f"{task.name}-medium"][0]

    def reached(line: dict[str, Any]) -> bool:
        return line["normalised_score"] >= medium

    def crossing() -> int | None:
        return next((line["step"] for line in curve_in(directory) if reached(line)), None)

    if crossing() is None:
        train(run, directory, progress, stop=reached)
    step = crossing()
    if step is None:
        raise ConfigError(f"{directory}: {run.steps:,} steps did not reach the score {medium}; try another seed")
    columns = Replay(directory / "replay.npy", task, run.steps).columns(step)
    columns["truncated"][-1] = not columns["terminated"][-1]
    versions = {package: version_of(package) for package in ("jax", "gymnasium", "mujoco", "numpy")}
    if run.contact_margins is not None:
        versions["contact_margins"] = run.contact_margins
    facts = {"generator": "odaf.behaviour.exact_replay", "seed": run.seed, "versions": versions}
    return judged(name, {kind: columns}, version, facts)
