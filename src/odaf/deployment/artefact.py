"""`odaf.export`: a policy in forms that need neither odaf nor JAX, each checked against the policy itself."""

import hashlib
import json
import os
import shutil
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from odaf.data.dataset import Dataset
from odaf.data.ranges import ranges as ranges_of
from odaf.data.writing import TEMPORARY_PREFIX
from odaf.deployment import check, contract
from odaf.deployment.c_form import write_c, write_c_test
from odaf.deployment.guard import GuardedPolicy
from odaf.deployment.guard_file import FORMAT as GUARD_FORMAT
from odaf.deployment.guard_program import guarded_program
from odaf.deployment.onnx_form import imported, write_onnx
from odaf.deployment.policies import OBSERVATION, action_names, input_columns, policy_program, with_formulas_outside
from odaf.deployment.safetensors_form import RUNNER, write_safetensors
from odaf.errors import ConfigError, DatasetError, OdafWarning
from odaf.training.files import plain, write_json
from odaf.training.policy import Policy
from odaf.training.run_directory import RunDirectory
from odaf.training.tensors import read_tensors

Form = Literal["numpy", "onnx", "c"]
FORMS: dict[str, str] = {"numpy": "policy.safetensors", "onnx": "policy.onnx", "c": "policy.h"}
"""The file of each form, by name."""


@dataclass(frozen=True)
class Artefact:
    """What `odaf export` wrote.

    Attributes:
        directory: where it lies.
        contract: the content of its `contract.json`.
    """

    directory: Path
    contract: Mapping[str, Any]

    def __str__(self) -> str:
        lines = [f"{self.directory}: {', '.join([*self.contract['files'], 'contract.json'])}"]
        for file, found in self.contract["checked"].items():
            if not found["checked"]:
                lines.append(f"  {file}: not checked: {found['reason']}")
                continue
            text = f"  {file}: {found['steps']} actions, at most {found['largest_difference']:.1e} of half a range off"
            if left := found["left_to_rounding"]:
                text += f"; at {left}, single precision does not tell the action to 1e-5"
            lines.append(text)
        return "\n".join(lines)


def export(
    policy: Policy | GuardedPolicy | str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    forms: Sequence[Form] = ("numpy", "onnx", "c"),
    max_change: Mapping[str, float] | None = None,
    formulas_outside: bool = False,
    named_inputs: bool = False,
    data: Dataset | str | os.PathLike[str] | None = None,
    training_seed: int | None = None,
    step: int | None = None,
    replace: bool = False,
) -> Artefact:
    """Writes a policy in forms that need neither odaf nor JAX: normaliser, bounds, limits and memory are inside.

    Every form is run in its own runtime and compared with the policy on random, extreme and boundary inputs, before
    anything appears at `out`.

    Args:
        policy: a policy, with a guard or without; the file of one; or a run's directory.
        out: folder to make.
        forms: "numpy" (`policy.safetensors`, and `odaf_policy.py`, which runs it with NumPy alone), "onnx" (needs the
            extra `export`), "c" (`policy.h`, and `policy_test.c`, which checks it where it is to run).
        max_change: the largest change of an action from one step to the next, by the action's name, in its unit.
        formulas_outside: observations that are formulas are computed by the caller and given by their names.
        named_inputs: the ONNX graph has an input for each column under its name, so that it refuses other names itself.
        data: the log, for the ranges that it has shown; None takes them from the run.
        training_seed: of a run, whose policy is taken; None the first.
        step: of a run, the checkpoint after so many updates; None the last.
        replace: remove a folder that is there once the new one is complete.

    Raises:
        ConfigError: an argument is out of range, the policy cannot be written, a package is missing, or a form does not
            do what the policy does.
        DatasetError: the log has other columns than the policy.
        CheckpointError: there is no run, policy or checkpoint.
        DivergenceError: the policy acts with numbers that are not finite.
    """
    unknown = [form for form in forms if form not in FORMS]
    if unknown or not forms:
        raise ConfigError(f"forms: {unknown[0] if unknown else 'none'} is no form; there are {', '.join(FORMS)}")
    place = Path(os.path.realpath(out))
    if place.exists() and not replace:
        raise ConfigError(f"{out}: exists already; name a new folder, or remove it first")
    guard = _guard_of(policy)
    if guard is not None and (max_change or formulas_outside):
        raise ConfigError(
            "max_change=, formulas_outside=: are not offered together with a guard; leave them out, or export the "
            "policy without its guard"
        )
    found, checkpoint, shown = _source(policy if guard is None else guard.policy, training_seed, step)
    if guard is not None and not isinstance(policy, GuardedPolicy):
        checkpoint = hashlib.sha256(Path(policy).read_bytes()).hexdigest()  # type: ignore[arg-type]
    formulas = {} if found.derivation is None else {n: f for n, f in found.derivation.parts if f is not None}
    if formulas_outside:
        found = with_formulas_outside(found)
    if data is not None:
        shown = _ranges_of_log(found, data if isinstance(data, Dataset) else Dataset.load(data))
    partial, former = (place.with_name(f"{TEMPORARY_PREFIX}{os.getpid()}-{age}-{place.name}") for age in ("new", "old"))
    try:
        partial.mkdir(parents=True)
        with tempfile.TemporaryDirectory() as work:
            checked = _write(found, partial, forms, dict(max_change or {}), shown, named_inputs, Path(work), guard)
        files = {each.name: each for each in sorted(partial.iterdir())}
        promise = None if guard is None else guard.to_dict()
        content = plain(
            contract.contract(found, formulas, max_change or {}, shown, checkpoint, checked, files, promise)
        )
        write_json(partial / "contract.json", content)
        if place.exists():
            os.replace(place, former)
        os.replace(partial, place)
        shutil.rmtree(former, ignore_errors=True)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return Artefact(Path(out), content)


def _guard_of(policy: Policy | GuardedPolicy | str | os.PathLike[str]) -> GuardedPolicy | None:
    if isinstance(policy, GuardedPolicy):
        return policy
    if isinstance(policy, Policy) or not Path(policy).is_file():
        return None
    _, metadata = read_tensors(Path(policy))
    return GuardedPolicy.load(policy) if metadata.get("format") == GUARD_FORMAT else None


def _source(
    policy: Policy | GuardedPolicy | str | os.PathLike[str], seed: int | None, step: int | None
) -> tuple[Policy, str | None, Mapping[str, Any] | None]:
    """The policy, the digest of what it was made of, and what the log has shown."""
    if isinstance(policy, GuardedPolicy):
        policy = policy.policy
    if isinstance(policy, Policy) or Path(policy).is_file():
        if seed is not None or step is not None:
            raise ConfigError("training_seed=, step=: choose a policy of a run; leave them out for a single policy")
        if isinstance(policy, Policy):
            return policy, None, None
        return Policy.load(policy), hashlib.sha256(Path(policy).read_bytes()).hexdigest(), None
    run = RunDirectory(Path(policy))
    seed = run.seeds[0] if seed is None else seed
    checkpoint = run.checkpoint(seed, step)
    return run.policy(seed, checkpoint.step), checkpoint.header().get("sha256"), run.data.get("ranges")


def _ranges_of_log(policy: Policy, log: Dataset) -> dict[str, Any]:
    if log.observation_names != policy.observation_names or log.act_dim != policy.act_dim:
        raise DatasetError(
            f"data: has the observations {', '.join(log.observation_names)} and {log.act_dim} actions, the policy "
            f"{', '.join(policy.observation_names)} and {policy.act_dim}; give the log that it learned from"
        )
    return ranges_of(log)


def _write(
    policy: Policy,
    folder: Path,
    forms: Sequence[Form],
    max_change: dict[str, float],
    ranges: Mapping[str, Any] | None,
    named_inputs: bool,
    work: Path,
    guard: GuardedPolicy | None,
) -> dict[str, dict[str, Any]]:
    """Writes the forms and compares them, compiling in `work`; how each compares, by file."""
    program = policy_program(policy, max_change) if guard is None else guarded_program(guard)
    if "onnx" in forms:
        imported("onnxruntime")
    trials = check.make_trials(policy, ranges, bool(program.carries))
    if guard is None:
        wanted = check.expected(policy, trials, max_change)
    else:
        trials, wanted = check.guarded_trials(guard, trials)
    command = check.compiler()
    with_program = folder / FORMS["numpy"]
    write_safetensors(program, with_program)
    rounding = check.measured_rounding(with_program)
    runners: dict[str, check.Runner] = {}
    if "numpy" in forms:
        shutil.copyfile(RUNNER, folder / RUNNER.name)
        runners[FORMS["numpy"]] = check.numpy_runner(with_program)
    if "onnx" in forms:
        write_onnx(program, folder / FORMS["onnx"], _metadata(policy, max_change, guard), named_inputs)
        runners[FORMS["onnx"]] = check.onnx_runner(folder / FORMS["onnx"])
    if "c" in forms:
        write_c(program, folder / FORMS["c"], _about(policy, max_change))
        if command is not None:
            runners[FORMS["c"]] = check.c_runner(folder / FORMS["c"], command, work)
    compared = {file: check.compare(file, runner, policy, trials, wanted, rounding) for file, runner in runners.items()}
    found = {file: {"checked": True, **agreement.to_dict()} for file, agreement in compared.items()}
    if "c" in forms:
        half = (np.asarray(policy.action_high) - np.asarray(policy.action_low)) / 2.0
        close = compared[FORMS["c"]].close if command is not None else None
        vectors = check.vectors(trials, wanted, rounding, half, close)
        write_c_test(folder / "policy_test.c", vectors, (check.TOLERANCE * half).tolist())
    if "c" in forms and command is not None:
        check.run_c_test(folder / "policy_test.c", command, work)
    elif "c" in forms:
        reason = "no C compiler here; compile and run policy_test.c where the policy is to run"
        found[FORMS["c"]] = {"checked": False, "reason": reason}
        warnings.warn(f"policy.h: not checked: {reason}", OdafWarning, stacklevel=3)
    if "numpy" not in forms:
        with_program.unlink()
    return found


def _metadata(policy: Policy, max_change: Mapping[str, float], guard: GuardedPolicy | None) -> dict[str, str]:
    """Of the ONNX file, beside names and units, which its inputs and outputs bring."""
    entries = {
        "bounds": {"low": policy.action_low, "high": policy.action_high},
        "max_change": dict(max_change),
        "status": contract.STATUS_MEANS if guard is None else contract.STATUS_MEANS | contract.GUARD_MEANS,
        **({} if guard is None else {"guard": plain(guard.to_dict())}),
        "provenance": plain(dict(policy.provenance)),
        "not_promised": contract.NOT_PROMISED,
    }
    return {name: json.dumps(entry) for name, entry in entries.items()}


def _about(policy: Policy, max_change: Mapping[str, float]) -> list[str]:
    """Lines for the head of the C form."""
    names = action_names(policy)
    units = dict(zip(names, policy.action_units, strict=False))
    lines = ["A policy that odaf exported. Not a safety case: see contract.json.", ""]
    lines.append(f"{OBSERVATION}: {', '.join(input_columns(policy))}")
    for name, low, high in zip(names, policy.action_low, policy.action_high, strict=True):
        limit = f", changes by at most {max_change[name]:g} a step" if name in max_change else ""
        lines.append(f"action {name}: {low:g} to {high:g} {units.get(name, '')}".rstrip() + limit)
    return lines
