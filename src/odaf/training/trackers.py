"""Metrics for TensorBoard, Weights & Biases and MLflow: small loggers around libraries that are extras.

Each library is loaded when training begins, in the process that trains, so a logger can be sent to workers. A seed is
one run of the tracker; a resumed seed goes on with it, and what was logged after its checkpoint is written anew.
"""

import hashlib
import importlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from odaf.errors import ConfigError
from odaf.training.files import read_json
from odaf.training.logging import Logger

Tracker = Literal["tensorboard", "wandb", "mlflow"]


def tracker(name: str) -> Logger:
    """The logger of a tracker by its name, with its usual settings.

    Raises:
        ConfigError: there is none of this name, or its library is not installed.
    """
    kinds: dict[str, type[TensorBoard] | type[WeightsAndBiases] | type[MLflow]] = {
        "tensorboard": TensorBoard, "wandb": WeightsAndBiases, "mlflow": MLflow,
    }  # fmt: skip
    if name not in kinds:
        raise ConfigError(f"log_to: {name!r} is not known; known are {', '.join(get_args(Tracker))}")
    kinds[name].library()
    return kinds[name]()


@dataclass
class TensorBoard:
    """Event files for `tensorboard --logdir FOLDER`, written with tensorboardX.

    Attributes:
        folder: where they go, a folder a seed; None puts them into `tensorboard/` in the seed's directory.
    """

    folder: str | None = None
    _writer: Any = field(default=None, init=False, repr=False)

    @staticmethod
    def library() -> Any:
        return _load("tensorboardX", "tensorboard")

    def open(self, directory: Path, step: int) -> None:
        place = directory / "tensorboard" if self.folder is None else Path(self.folder) / _title(directory)
        # TensorBoard itself forgets what was logged from this step on.
        self._writer = self.library().SummaryWriter(str(place), purge_step=step + 1)

    def log(self, step: int, metrics: Mapping[str, float | int]) -> None:
        for name, value in metrics.items():
            self._writer.add_scalar(name, value, step)

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None


@dataclass
class WeightsAndBiases:
    """A run on Weights & Biases for every seed; a resumed seed goes on with its own.

    Attributes:
        project: its name.
        mode: `online`, `offline` (written below `wandb/` in the seed's directory, for `wandb sync`), or None for what
            WANDB_MODE says.
    """

    project: str = "odaf"
    mode: str | None = None
    _run: Any = field(default=None, init=False, repr=False)

    @staticmethod
    def library() -> Any:
        return _load("wandb", "wandb")

    def open(self, directory: Path, step: int) -> None:
        # Its step only ever grows, so ours is a column of its own, and what is logged again stands there again.
        self._run = self.library().init(
            project=self.project,
            name=_title(directory),
            id=_identity(directory),
            resume="allow",
            dir=str(directory),
            mode=self.mode,
            config=_config(directory),
        )
        self._run.define_metric("update")
        self._run.define_metric("*", step_metric="update")

    def log(self, step: int, metrics: Mapping[str, float | int]) -> None:
        self._run.log({"update": step, **metrics})

    def close(self) -> None:
        if self._run is not None:
            self._run.finish()
            self._run = None


@dataclass
class MLflow:
    """A run of MLflow for every seed; a resumed seed goes on with its own. MLFLOW_TRACKING_URI says where.

    Attributes:
        experiment: its name.
    """

    experiment: str = "odaf"
    _client: Any = field(default=None, init=False, repr=False)
    _run_id: str = field(default="", init=False, repr=False)

    @staticmethod
    def library() -> Any:
        return _load("mlflow", "mlflow")

    def open(self, directory: Path, step: int) -> None:
        library = self.library()
        self._client = library.MlflowClient()
        found = self._client.get_experiment_by_name(self.experiment)
        experiment = self._client.create_experiment(self.experiment) if found is None else found.experiment_id
        identity = _identity(directory)
        known = self._client.search_runs([experiment], filter_string=f"tags.odaf_seed = '{identity}'")
        if known:
            self._run_id = known[0].info.run_id
            self._client.update_run(self._run_id, status="RUNNING")
            return
        tags = {"odaf_seed": identity, "mlflow.runName": _title(directory)}
        self._run_id = self._client.create_run(experiment, tags=tags).info.run_id
        for name, value in _flat(_config(directory)).items():
            self._client.log_param(self._run_id, name, str(value)[:500])

    def log(self, step: int, metrics: Mapping[str, float | int]) -> None:
        for name, value in metrics.items():
            if math.isfinite(value):  # its stores take no other numbers
                self._client.log_metric(self._run_id, name, value, step=step)

    def close(self) -> None:
        if self._client is not None:
            self._client.set_terminated(self._run_id)
            self._client = None


def _load(module: str, extra: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ConfigError(f'log_to: {extra} needs {module} ({error}); pip install "odaf[{extra}]"') from error


def _title(directory: Path) -> str:
    """A seed's directory in words: `maze-seed-0`."""
    return f"{directory.resolve().parent.name}-{directory.name}"


def _identity(directory: Path) -> str:
    """The same for one seed's directory however often it is opened, and for no other."""
    return hashlib.sha256(str(directory.resolve()).encode()).hexdigest()[:16]


def _config(directory: Path) -> dict[str, Any]:
    return read_json(directory.parent / "config.json", "Give the directory of a run.")


def _flat(settings: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Nested settings under dotted names; lists of settings by their place."""
    found: dict[str, Any] = {}
    for name, value in settings.items():
        if isinstance(value, Mapping):
            found |= _flat(value, f"{before}{name}.")
        elif isinstance(value, Sequence) and any(isinstance(item, Mapping) for item in value):
            found |= _flat({str(place): item for place, item in enumerate(value)}, f"{before}{name}.")
        else:
            found[f"{before}{name}"] = value
    return found
