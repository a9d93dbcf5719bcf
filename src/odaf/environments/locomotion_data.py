"""Locomotion data recorded on the spot: the names of the public benchmark's sets, our own policies' episodes.

`random` plays uniform actions; `medium` and `expert` play one policy each, stochastically; `medium-replay` plays the
training run up to the medium policy, snapshot after snapshot, each for its share of the run; `medium-expert` is a
medium half followed by an expert half. docs/reference/generated-data.md says how each differs from the public set of
its name.
"""

from collections.abc import Mapping, Sequence
from importlib.metadata import version as version_of
from typing import Any

import numpy as np

from odaf.data.dataset import Dataset
from odaf.data.rows import COLUMNS
from odaf.environments.contact_margins import ContactMargins
from odaf.environments.gaussian_policy import GaussianPolicy
from odaf.environments.locomotion import TASKS, Simulator, Task, task_of
from odaf.environments.locomotion_acceptance import acceptance_of, findings_of, statistics_of
from odaf.environments.recorder import record, slots_for
from odaf.environments.shipped_policies import Phase, ShippedPolicies, shipped
from odaf.errors import ConfigError
from odaf.training.progress import ProgressReport, Silent

KINDS = ("random", "medium", "medium-replay", "medium-expert", "expert")
# What of a page of facts says who played: of the sets that are not one level.
_PLAYERS = {"random": (), "medium-replay": ("replay",), "medium-expert": ("medium", "expert")}
NAMES = tuple(f"{task}-{kind}" for task in TASKS for kind in KINDS)


def generate(
    name: str,
    transitions: int,
    seed: int = 0,
    version: str = "v4",
    progress: ProgressReport | None = None,
    policies: ShippedPolicies | None = None,
    contact_margins: ContactMargins | None = None,
    edition: int | None = None,
) -> Dataset:
    """Records the set called `name`; one seed gives the same bits on the same machine and versions.

    `infos` hold `qpos`, `qvel` and `action_log_probs` (of the policy that acted). `provenance` holds the figures of the
    recording under "statistics", whether they are near those of the published set under "acceptance", a finding for
    each that is not, and under "policies" the edition and what is known of those who played.

    Args:
        name: one of `NAMES`.
        transitions: rows, exactly; the last episode is cut to fit, and so is that of each phase of a replay.
        seed: chooses starts and actions.
        version: of the environment; published scores belong to one near v4.
        progress: hears how many rows are recorded.
        policies: what acts; None takes the shipped ones.
        contact_margins: how the simulator counts them, see `odaf.environments.contact_margins`; None is as the
            installed one does. What is given is recorded.
        edition: of the shipped policies, see `odaf.environments.shipped_policies.shipped`; None is the newest.

    Raises:
        ConfigError: the name, version or edition is not known, or the policy it needs is not there.
    """
    task, kind = split_name(name, version)
    if transitions < 1:
        raise ConfigError(f"transitions={transitions} must be at least 1")
    if policies is None and kind != "random":
        policies = shipped(task, edition)
    parts = _parts(task, kind, transitions, policies)
    progress = progress or Silent()
    progress.start(name, transitions, unit="rows")
    largest = max(phase.steps for phases in parts.values() for phase in phases)
    simulators = [Simulator(task, version, contact_margins) for _ in range(slots_for(largest))]
    streams = iter(np.random.SeedSequence(seed).spawn(sum(map(len, parts.values()))))
    pieces: dict[str, dict[str, np.ndarray]] = {}
    done = 0
    for part, phases in parts.items():
        recordings = []
        for phase in phases:
            before, rng = done, np.random.default_rng(next(streams))
            recordings.append(
                record(
                    simulators,
                    phase.policy,
                    phase.steps,
                    rng,
                    lambda steps, before=before: progress.advance(before + steps),
                )
            )
            done += phase.steps
        pieces[part] = _joined(recordings)
    progress.close()
    versions = {package: version_of(package) for package in ("gymnasium", "mujoco", "numpy")}
    if contact_margins is not None:
        versions["contact_margins"] = contact_margins
    facts = {
        "generator": "odaf.environments.locomotion_data",
        "seed": seed,
        "policies": {} if policies is None else _told(policies.facts, kind),
        "versions": versions,
    }
    return judged(name, pieces, version, facts)


def judged(
    name: str, pieces: Mapping[str, Mapping[str, np.ndarray]], version: str, facts: Mapping[str, Any]
) -> Dataset:
    """Recorded columns as a dataset that carries its figures and what they say about its name.

    Args:
        name: one of `NAMES`.
        pieces: columns of each part that is judged on its own, in order; those that `Dataset` does not name are infos.
        version: of the environment.
        facts: further provenance.
    """
    task, kind = split_name(name, version)
    figures = {part: statistics_of(piece, task, version) for part, piece in pieces.items()}
    acceptance = acceptance_of(task, kind, figures)
    columns: dict[str, Any] = _joined(list(pieces.values()))
    environment = {"name": "gymnasium", "id": task.environment_id(version), "kwargs": {}}
    if rule := facts.get("versions", {}).get("contact_margins"):
        environment["contact_margins"] = rule
    statistics = statistics_of(columns, task, version)
    if len(figures) > 1:
        statistics["parts"] = figures
    return Dataset.from_arrays(
        **{key: columns.pop(key) for key in COLUMNS},
        action_bounds=(-1.0, 1.0),
        infos=columns,
        provenance={
            "name": name,
            "origin": "locally generated data",
            "environment": environment,
            **facts,
            "statistics": statistics,
            "acceptance": acceptance,
            "findings": findings_of(acceptance),
        },
        source=name,
    )


def split_name(name: str, version: str = "v4") -> tuple[Task, str]:
    """Task and kind of a set's name.

    Raises:
        ConfigError: there is no such set or version.
    """
    task, _, kind = name.partition("-")
    if name not in NAMES:
        raise ConfigError(f"data set '{name}' is not known; known are {', '.join(NAMES)}")
    return task_of(task, version), kind


def shares(phases: Sequence[Phase], transitions: int) -> list[Phase]:
    """The same phases with `transitions` steps in all, in proportion; those left without a step are dropped."""
    borders = np.cumsum([0, *(phase.steps for phase in phases)])
    borders = np.round(borders * (transitions / borders[-1])).astype(int)
    steps = np.diff(borders).tolist()
    return [Phase(share, phase.policy) for share, phase in zip(steps, phases, strict=True) if share > 0]


def _parts(task: Task, kind: str, transitions: int, policies: ShippedPolicies | None) -> dict[str, list[Phase]]:
    """Who plays how long: a list of phases for every part that is judged on its own."""
    if policies is None:
        return {"random": [Phase(transitions, None)]}
    if kind == "medium-replay":
        if not policies.replay:
            raise ConfigError(f"{task.name}-{kind}: no snapshots of a training run are shipped for this task")
        return {kind: shares(policies.replay, transitions)}
    if kind == "medium-expert":
        half = transitions // 2
        if half < 1:
            raise ConfigError(f"{task.name}-{kind}: transitions={transitions} must be at least 2, one of each half")
        return {
            "medium": [Phase(transitions - half, _level(task, "medium", policies))],
            "expert": [Phase(half, _level(task, "expert", policies))],
        }
    return {kind: [Phase(transitions, None if kind == "random" else _level(task, kind, policies))]}


def _told(facts: Mapping[str, Any], kind: str) -> dict[str, Any]:
    """What a page of facts says of those who play in sets of a kind."""
    names = ("edition", "training", *_PLAYERS.get(kind, (kind,)))
    return {name: facts[name] for name in names if name in facts}


def _level(task: Task, level: str, policies: ShippedPolicies) -> GaussianPolicy:
    policy: GaussianPolicy | None = getattr(policies, level)
    if policy is None:
        raise ConfigError(
            f"no {level} policy of {task.name} is shipped with this version: no training run has reached its level; "
            f"train on with `odaf behaviour train {task.name} --out DIR` and add it with `odaf behaviour export DIR`"
        )
    return policy


def _joined(recordings: Sequence[Mapping[str, np.ndarray]]) -> dict[str, Any]:
    if len(recordings) == 1:
        return dict(recordings[0])
    return {name: np.concatenate([recording[name] for recording in recordings]) for name in recordings[0]}
