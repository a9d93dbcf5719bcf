"""Metrics for TensorBoard, Weights & Biases and MLflow: small loggers around libraries that are extras.

Each library is loaded when training begins, in the process that trains, so a logger can be sent to workers. A seed is
one run of the tracker; a resumed seed goes on with it, and what was logged after its checkpoint is written anew.
"""

import abc
import hashlib
import importlib
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

from odaf.errors import ConfigError, OdafWarning
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
class _Tracked(abc.ABC):
    """A logger whose library may fail: at the start that is said, later it costs the log and never the training."""

    _handle: Any = field(default=None, init=False, repr=False)

    @staticmethod
    @abc.abstractmethod
    def library() -> Any:
        """The library, loaded."""

    @abc.abstractmethod
    def begin(self, directory: Path, step: int) -> Any:
        """Opens what `send` writes to."""

    @abc.abstractmethod
    def send(self, handle: Any, step: int, metrics: Mapping[str, float]) -> None:
        """Writes finite numbers."""

    @abc.abstractmethod
    def end(self, handle: Any) -> None:
        """Closes it."""

    def open(self, directory: Path, step: int) -> None:
        try:
            self._handle = self.begin(directory, step)
        except ConfigError:
            raise
        except Exception as error:  # no account, no server, no space: as many as there are libraries
            raise ConfigError(
                f"log_to: {type(self).__name__} cannot begin ({type(error).__name__}: {error}); mend its set-up, or "
                "train without it"
            ) from error

    def log(self, step: int, metrics: Mapping[str, float | int]) -> None:
        finite = {name: float(value) for name, value in metrics.items() if math.isfinite(value)}
        self._attempt(lambda handle: self.send(handle, step, finite))

    def close(self) -> None:
        self._attempt(self.end)
        self._handle = None

    def _attempt(self, action: Callable[[Any], object]) -> None:
        if self._handle is None:
            return
        try:
            action(self._handle)
        except Exception as error:
            self._handle = None
            text = f"{type(self).__name__} fails and hears no more of this seed; training goes on ({error})"
            warnings.warn(text, OdafWarning, stacklevel=2)


@dataclass
class TensorBoard(_Tracked):
    """Event files for `tensorboard --logdir FOLDER`, written with tensorboardX.

    Attributes:
        folder: where they go, a folder a seed; None puts them into `tensorboard/` in the seed's directory.
    """

    folder: str | None = None

    @staticmethod
    def library() -> Any:
        return _load("tensorboardX", "tensorboard")

    def begin(self, directory: Path, step: int) -> Any:
        place = directory / "tensorboard" if self.folder is None else Path(self.folder) / _title(directory)
        # TensorBoard itself forgets what was logged from this step on.
        return self.library().SummaryWriter(str(place), purge_step=step + 1)

    def send(self, handle: Any, step: int, metrics: Mapping[str, float]) -> None:
        for name, value in metrics.items():
            handle.add_scalar(name, value, step)

    def end(self, handle: Any) -> None:
        handle.close()


@dataclass
class WeightsAndBiases(_Tracked):
    """A run on Weights & Biases for every seed; a resumed seed goes on with its own.

    Attributes:
        project: its name.
        mode: `online`, `offline` (written below `wandb/` in the seed's directory, for `wandb sync`), or None for what
            WANDB_MODE says.
    """

    project: str = "odaf"
    mode: str | None = None

    @staticmethod
    def library() -> Any:
        return _load("wandb", "wandb")

    def begin(self, directory: Path, step: int) -> Any:
        # Its own step only ever grows, so ours is a column, and what is logged again stands there again.
        run = self.library().init(
            project=self.project,
            name=_title(directory),
            id=_identity(directory),
            resume="allow",
            dir=str(directory),
            mode=self.mode,
            config=_config(directory),
        )
        run.define_metric("update")
        run.define_metric("*", step_metric="update")
        return run

    def send(self, handle: Any, step: int, metrics: Mapping[str, float]) -> None:
        handle.log({"update": step, **metrics})

    def end(self, handle: Any) -> None:
        handle.finish()


@dataclass
class MLflow(_Tracked):
    """A run of MLflow for every seed; a resumed seed goes on with its own. MLFLOW_TRACKING_URI says where.

    Attributes:
        experiment: its name.
    """

    experiment: str = "odaf"

    @staticmethod
    def library() -> Any:
        return _load("mlflow", "mlflow")

    def begin(self, directory: Path, step: int) -> Any:
        client = self.library().MlflowClient()
        found = client.get_experiment_by_name(self.experiment)
        experiment = client.create_experiment(self.experiment) if found is None else found.experiment_id
        identity = _identity(directory)
        known = client.search_runs([experiment], filter_string=f"tags.odaf_seed = '{identity}'")
        if known:
            run_id = known[0].info.run_id
            client.update_run(run_id, status="RUNNING")
            return client, run_id
        tags = {"odaf_seed": identity, "mlflow.runName": _title(directory)}
        run_id = client.create_run(experiment, tags=tags).info.run_id
        for name, value in _flat(_config(directory)).items():
            client.log_param(run_id, name, str(value)[:500])
        return client, run_id

    def send(self, handle: Any, step: int, metrics: Mapping[str, float]) -> None:
        client, run_id = handle
        for name, value in metrics.items():
            client.log_metric(run_id, name, value, step=step)

    def end(self, handle: Any) -> None:
        client, run_id = handle
        client.set_terminated(run_id)


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
