"""Reading what a run leaves on the disk: everything needed to explain, use, repeat or continue it.

    config.json        every resolved setting
    environment.json   versions, device and command of the process that began it, and of each that resumed it
    data.json          where the data came from, their fingerprint, sizes, normaliser and environment
    data_sample.npz    returns of all logged episodes and some episodes themselves, for pictures
    seed-S/            metrics.jsonl, checkpoints/STEP/, evaluations/STEP.npz, summary.json

Paths inside the files stand as the user gave them. This is the only reader of these files; `run_writing` writes them.
"""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import equinox as eqx
import jax.random as jr
import numpy as np

from odaf.algorithms.base import Algorithm
from odaf.algorithms.config import from_dict
from odaf.data.derived import Derivation
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.errors import CheckpointError, ConfigError
from odaf.training import averaging, checkpoints, logging
from odaf.training.checkpoints import Checkpoint
from odaf.training.files import read_arrays, read_json
from odaf.training.logging import Series
from odaf.training.policy import Policy
from odaf.training.settings import named_precision

FORMAT = "odaf-run"
# 2: the state of the ensemble learner is laid out anew; settings of the whole run. Reports and scores of 1 still work.
VERSION = 2
_READABLE = (1, 2)
_TRAINED_WITH = ("algorithm", "evaluate", "checkpoint_every", "keep_checkpoints", "stretch", "on_divergence")

_NO_RUN = "Give the directory that `odaf train --out` or `odaf.fit` wrote."
_DAMAGED = "Restore the file, or train again."


@dataclass(frozen=True)
class RunDirectory:
    """One run on the disk. Nothing is read before it is asked for; settings are read once, results every time."""

    path: Path

    @functools.cached_property
    def config(self) -> dict[str, Any]:
        """`config.json`, checked for its format.

        Raises:
            CheckpointError: there is no run here, or the file is damaged.
        """
        path = self.path / "config.json"
        several = sorted(each.parent.name for each in self.path.glob("*/config.json")) if not path.exists() else []
        if several:
            raise CheckpointError(
                f"{self.path}: holds {len(several)} runs, such as {several[0]}, and is none itself; the `odaf train` "
                "command that began them goes on with all, `odaf resume` with one: give its directory"
            )
        config = read_json(path, _NO_RUN)
        if config.get("format") != FORMAT:
            raise CheckpointError(
                f"{path}: field 'format' is {config.get('format')!r}, expected {FORMAT!r}; this directory was not "
                f"written by `odaf train`. {_NO_RUN}"
            )
        if config.get("version") not in _READABLE:
            raise CheckpointError(
                f"{path}: field 'version' is {config.get('version')!r}, this odaf reads versions up to {VERSION}; use "
                "the version of odaf that made the run"
            )
        _require(path, config, ("steps", "seeds"))
        if "precision" in config:
            config["precision"] = named_precision(config["precision"], config.get("device", ""))
        return config

    def require_current(self) -> None:
        """Makes sure that this odaf understands the learner's state in the run's checkpoints, and how it was trained.

        Raises:
            CheckpointError: an older one wrote it; the message names that version. Or settings are missing.
        """
        if self.config["version"] == VERSION:
            _require(self.path / "config.json", self.config, _TRAINED_WITH)
            return
        writer = self.machine.get("versions", {}).get("odaf", "0.1.0")
        raise CheckpointError(
            f"{self.path}: was written by odaf {writer}, whose learners keep their state in another form; go on with "
            f"that version (pip install odaf=={writer}), or train again. Its report and its scores can still be made"
        )

    @functools.cached_property
    def data(self) -> dict[str, Any]:
        """`data.json`."""
        return read_json(self.path / "data.json", _NO_RUN)

    @property
    def machine(self) -> dict[str, Any]:
        """`environment.json`; empty where it is absent."""
        return self._json_if_there("environment.json")

    @property
    def sample(self) -> dict[str, np.ndarray]:
        """Arrays of `data_sample.npz`; empty where it is absent.

        Raises:
            CheckpointError: the file is damaged or holds anything but plain arrays.
        """
        path = self.path / "data_sample.npz"
        return read_arrays(path, _DAMAGED) if path.exists() else {}

    @functools.cached_property
    def algorithm(self) -> Algorithm:
        """The learner, rebuilt from its resolved settings."""
        self.require_current()
        try:
            return from_dict(self.config["algorithm"])
        except ConfigError as error:
            raise CheckpointError(f"{self.path / 'config.json'}: algorithm: {error}") from None

    @functools.cached_property
    def spec(self) -> Spec:
        """Sizes, bounds and reward range of the training data."""
        return Spec.from_dict(self.data["spec"])

    @functools.cached_property
    def normaliser(self) -> Normaliser:
        """The map of observations fitted on the training data."""
        return Normaliser.from_dict(self.data["normaliser"])

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds that were asked for, whether or not their training has begun."""
        return tuple(self.config["seeds"])

    @property
    def evaluation_environment(self) -> Mapping[str, Any] | None:
        """Description of where policies were evaluated, or else of where the data were recorded, if either is known."""
        settings = self.config.get("evaluate")
        own = settings.get("environment") if isinstance(settings, Mapping) else None
        found = own if isinstance(own, Mapping) else self._json_if_there("data.json").get("environment")
        return found if isinstance(found, Mapping) else None

    def seed_directory(self, seed: int) -> Path:
        """Where one seed's files lie.

        Raises:
            ConfigError: the run has no such seed.
        """
        if seed not in self.seeds:
            raise ConfigError(f"{self.path}: has no seed {seed}; it has {', '.join(map(str, self.seeds))}")
        return self.path / f"seed-{seed}"

    def checkpoints(self, seed: int) -> list[Checkpoint]:
        """The seed's checkpoints, earliest first."""
        return checkpoints.listed(self.seed_directory(seed) / "checkpoints")

    def checkpoint(self, seed: int, step: int | None = None) -> Checkpoint:
        """The seed's checkpoint after `step` updates, or its last.

        Raises:
            CheckpointError: there is none; the message lists those there are, and says if it was not kept.
        """
        found = self.checkpoints(seed)
        chosen = found[-1:] if step is None else [checkpoint for checkpoint in found if checkpoint.step == step]
        if chosen:
            return chosen[0]
        steps = ", ".join(str(checkpoint.step) for checkpoint in found) or "none"
        wanted = "no checkpoint" if step is None else f"no checkpoint of step {step}"
        keep = self.config.get("keep_checkpoints", "all")
        if step is not None and found and 0 <= step < found[-1].step and keep != "all":
            wanted += (
                f" (of older checkpoints this run keeps {checkpoints.rule(keep)}; "
                "--keep-checkpoints all keeps every one)"
            )
        raise CheckpointError(
            f"{self.seed_directory(seed) / 'checkpoints'}: {wanted}; there are: {steps}. "
            "Choose one of these, or go on training with `odaf resume`."
        )

    def state(self, seed: int, step: int | None = None) -> Any:
        """The learner's complete state after `step` updates, or the last one saved."""
        self.require_current()
        return self.checkpoint(seed, step).load(blank_state(self.algorithm, self.spec), identity={"seed": seed})

    def policy(self, seed: int, step: int | None = None) -> Policy:
        """What the seed had learned after `step` updates, or at its last checkpoint; needs no dataset."""
        checkpoint = self.checkpoint(seed, step)
        return self.policy_of(self.state(seed, checkpoint.step), seed=seed, step=checkpoint.step)

    def policy_of(self, state: Any, **provenance: int) -> Policy:
        """The policy of a learner's state, with the names and units of the data it learns from.

        Args:
            state: of the run's learner.
            **provenance: what the policy says about where it comes from, beside learner, preset and data.
        """
        fields = ("observation_names", "action_names", "observation_units", "action_units")
        columns = {field: tuple(self.data["summary"].get(field, ())) for field in fields}
        return Policy(
            averaging.deployed_actor(self.algorithm, state),
            self.normaliser,
            self.spec.action_low,
            self.spec.action_high,
            **columns,
            provenance={
                "learner": self.algorithm.kind,
                "preset": self.config.get("preset"),
                "data_sha256": self.data.get("sha256"),
                "data_rows_sha256": self.data.get("rows_sha256"),
                **provenance,
            },
            derivation=self.derivation,
        )

    @functools.cached_property
    def derivation(self) -> Derivation | None:
        """How observations are computed from readings; None where the data hold the readings themselves.

        Raises:
            DatasetError: another version of odaf recorded it.
        """
        return Derivation.from_provenance(self.data["summary"].get("provenance", {}))

    def metrics(self, seed: int) -> list[dict[str, Any]]:
        """The lines of the seed's `metrics.jsonl`; one torn by a kill is left out."""
        return logging.read(self.seed_directory(seed) / "metrics.jsonl")

    def series(self, seed: int) -> dict[str, Series]:
        """The seed's logged quantities by name."""
        return logging.series(self.metrics(seed))

    def summary(self, seed: int) -> dict[str, Any]:
        """The seed's state of affairs at its last checkpoint; `status` is one of "not started", "running" (which
        includes runs that were cut off), "diverged" and "finished".

        Where checkpoints were removed, `summary.json` still tells."""
        found = self.checkpoints(seed)
        if found:
            summary = found[-1].header()["summary"]
        else:
            path = self.seed_directory(seed) / "summary.json"
            nothing = {"seed": seed, "step": 0, "status": "not started", "evaluation": None, "warnings": []}
            summary = read_json(path, _DAMAGED) if path.exists() else nothing
        if summary.get("status") == "finished" and summary.get("step", 0) < self.config["steps"]:
            summary["status"] = "running"  # it was finished once, and made longer since
        return summary

    def episodes(self, seed: int) -> tuple[int, dict[str, np.ndarray]] | None:
        """Step and arrays of the seed's latest recorded evaluation: observations [episodes, time, obs_dim], returns
        [episodes], flags; None where there is none.

        Raises:
            CheckpointError: the file is damaged or holds anything but plain arrays.
        """
        files = {
            int(path.stem): path
            for path in (self.seed_directory(seed) / "evaluations").glob("*.npz")
            if path.stem.isdigit()
        }
        return (max(files), read_arrays(files[max(files)], "Evaluate again.")) if files else None

    def _json_if_there(self, name: str) -> dict[str, Any]:
        path = self.path / name
        return read_json(path, _DAMAGED) if path.exists() else {}


def _require(path: Path, config: Mapping[str, Any], fields: Sequence[str]) -> None:
    for field in fields:
        if field not in config:
            raise CheckpointError(f"{path}: {field}: is missing, so the file was changed. {_NO_RUN}")


def blank_state(algorithm: Algorithm, spec: Spec) -> Any:
    """The structure of a learner's state, with shapes in place of arrays."""

    def build(key):
        key_models, key_init = jr.split(key)
        return averaging.begin(algorithm, key_init, spec, algorithm.untrained(key_models, spec))

    return eqx.filter_eval_shape(build, jr.key(0))
