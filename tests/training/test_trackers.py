"""Loggers for trackers, against tiny stand-ins for their libraries; the real ones where they are installed."""

import pickle
import sys
import types
from typing import Any

import pytest

from odaf import training
from odaf.errors import ConfigError, OdafWarning
from odaf.training.trackers import MLflow, TensorBoard, WeightsAndBiases, tracker


class Heard:
    """What a tracker's library was told, by run."""

    def __init__(self):
        self.opened: list[dict[str, Any]] = []
        self.lines: list[tuple[int, str, float]] = []
        self.closed = 0


def _tensorboard(heard):
    class SummaryWriter:
        def __init__(self, logdir, purge_step):
            heard.opened.append({"place": logdir, "purge_step": purge_step})

        def add_scalar(self, name, value, step):
            heard.lines.append((step, name, value))

        def close(self):
            heard.closed += 1

    return types.SimpleNamespace(SummaryWriter=SummaryWriter)


def _wandb(heard):
    class Run:
        def define_metric(self, name, step_metric=None): ...

        def log(self, row):
            heard.lines.extend((row["update"], name, value) for name, value in row.items() if name != "update")

        def finish(self):
            heard.closed += 1

    def init(**options):
        heard.opened.append(options)
        return Run()

    return types.SimpleNamespace(init=init)


def _mlflow(heard):
    runs: list[Any] = []

    class MlflowClient:
        def get_experiment_by_name(self, name):
            return types.SimpleNamespace(experiment_id="7") if runs else None

        def create_experiment(self, name):
            return "7"

        def search_runs(self, experiments, filter_string):
            return [run for run in runs if filter_string == f"tags.odaf_seed = '{run.tag}'"]

        def create_run(self, experiment, tags):
            run = types.SimpleNamespace(info=types.SimpleNamespace(run_id=f"run{len(runs)}"), tag=tags["odaf_seed"])
            runs.append(run)
            heard.opened.append({"tags": tags, "params": {}})
            return run

        def update_run(self, run_id, status):
            heard.opened.append({"again": run_id})

        def log_param(self, run_id, name, value):
            heard.opened[-1]["params"][name] = value

        def log_metric(self, run_id, name, value, step):
            heard.lines.append((step, name, value))

        def set_terminated(self, run_id):
            heard.closed += 1

    return types.SimpleNamespace(MlflowClient=MlflowClient)


@pytest.mark.parametrize(
    ("name", "module", "library"),
    [("tensorboard", "tensorboardX", _tensorboard), ("wandb", "wandb", _wandb), ("mlflow", "mlflow", _mlflow)],
)
def test_a_tracker_hears_what_the_file_holds_and_goes_on_with_a_resumed_seed(
    tiny, tmp_path, monkeypatch, name, module, library
):
    heard = Heard()
    monkeypatch.setitem(sys.modules, module, library(heard))
    logger = pickle.loads(pickle.dumps(tracker(name)))  # as a worker gets it
    data = tiny.tiny_dataset()
    run = training.fit(
        tiny.TinyLearner(), data, steps=4, stretch=2, directory=tmp_path / "maze", progress=False, loggers=(logger,)
    )
    training.resume(run.path, 6, dataset=data, progress=False, loggers=(logger,))
    told = [(line["step"], key, value) for line in run.metrics(0) for key, value in line.items() if key != "step"]
    assert heard.lines == told and heard.closed == 2 and len(heard.opened) == 2
    first, second = heard.opened
    if name == "tensorboard":
        assert first == {"place": str(tmp_path / "maze" / "seed-0" / "tensorboard"), "purge_step": 1}
        assert second["purge_step"] == 5
    elif name == "wandb":
        assert first["id"] == second["id"] and first["name"] == "maze-seed-0" and first["resume"] == "allow"
        assert first["config"]["algorithm"]["learning_rate"] == 0.1
    else:
        assert first["tags"]["mlflow.runName"] == "maze-seed-0" and second == {"again": "run0"}
        assert first["params"]["algorithm.learning_rate"] == "0.1"


@pytest.mark.parametrize(
    ("name", "module"), [("tensorboard", "tensorboardX"), ("wandb", "wandb"), ("mlflow", "mlflow")]
)
def test_a_library_that_is_missing_is_named_with_its_extra(monkeypatch, name, module):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ConfigError, match=rf'{name} needs {module} .*pip install "odaf\[{name}\]"'):
        tracker(name)
    with pytest.raises(ConfigError, match=r"'comet' is not known; known are tensorboard, wandb, mlflow"):
        tracker("comet")


def test_a_tracker_that_fails_costs_its_log_and_not_the_training(tiny, tmp_path, monkeypatch):
    heard = Heard()
    library = _tensorboard(heard)
    monkeypatch.setitem(sys.modules, "tensorboardX", library)

    def full(self, name, value, step):
        raise OSError("disk full")

    monkeypatch.setattr(library.SummaryWriter, "add_scalar", full)
    data, settings = tiny.tiny_dataset(), {"steps": 4, "stretch": 2, "progress": False}
    with pytest.warns(OdafWarning, match=r"TensorBoard fails and hears no more .*disk full") as said:
        run = training.fit(tiny.TinyLearner(), data, directory=tmp_path / "a", loggers=(TensorBoard(),), **settings)
    assert len(said) == 1 and run.summary(0)["status"] == "finished"

    def nowhere(*arguments, **options):
        raise OSError("read-only")

    monkeypatch.setattr(library, "SummaryWriter", nowhere)
    with pytest.raises(ConfigError, match=r"TensorBoard cannot begin \(OSError: read-only\)"):
        training.fit(tiny.TinyLearner(), data, directory=tmp_path / "b", loggers=(TensorBoard(),), **settings)


def test_event_files_hold_the_metrics(tmp_path):
    pytest.importorskip("tensorboardX")
    (tmp_path / "seed-0").mkdir()
    logger = TensorBoard()
    logger.open(tmp_path / "seed-0", 0)
    logger.log(3, {"critic/mean": 1.5})
    logger.close()
    (file,) = (tmp_path / "seed-0" / "tensorboard").iterdir()
    assert b"critic/mean" in file.read_bytes()


def test_loggers_that_were_never_opened_close_quietly():
    for logger in (TensorBoard(), WeightsAndBiases(), MLflow()):
        logger.close()
