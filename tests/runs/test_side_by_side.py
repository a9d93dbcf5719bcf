"""Seeds trained side by side: the bits of one after another, one run directory, one line of progress."""

import io
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import odaf
from odaf import training
from odaf.environments.maze import STITCH
from odaf.runs.side_by_side import default_workers, side_by_side
from odaf.training.combined_progress import CombinedProgress, SeedReport
from odaf.training.fit import one_after_another as sequential
from odaf.training.progress import Lines
from odaf.training.settings import RunSettings

# A process on one core: so its own seeds and those of its workers are computed with one thread.
SCRIPT = """
import os, sys
import odaf

if __name__ == "__main__":
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    data, out, workers, steps = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    evaluate = odaf.Rollouts(episodes=2, every=steps // 2)
    learner = odaf.BehaviourCloning(hidden_sizes=(8,), batch_size=8)
    odaf.fit(learner, data, steps=steps, directory=out, seeds=(0, 1, 2), workers=workers, evaluate=evaluate,
             checkpoint_every=10, stretch=5)
"""


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three episodes of random steps in the shape of the maze task."""
    rng = np.random.default_rng(0)
    path = tmp_path_factory.mktemp("data") / "maze.h5"
    states = rng.uniform(-1, 1, (3, 21, 4)).astype(np.float32)
    odaf.Dataset.from_arrays(
        states[:, :-1].reshape(-1, 4),
        rng.uniform(-1, 1, (60, 2)),
        rng.uniform(0, 1, 60),
        states[:, 1:].reshape(-1, 4),
        truncated=np.arange(60) % 20 == 19,
        action_bounds=(-1.0, 1.0),
        provenance={"environment": {"name": "pointmaze", "maze": STITCH.to_dict(), "steps": 5}},
    ).save(path)
    return path


@pytest.fixture(scope="module")
def one_after_another(data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "one-after-another"
    assert _finish(_start(data, out, 1, 40))[0] == 0
    return out


def _start(data: Path, out: Path, workers: int, steps: int) -> subprocess.Popen:
    script = data.with_name("script.py")
    script.write_text(SCRIPT)
    source = Path(odaf.__file__).parents[1]
    return subprocess.Popen(
        [sys.executable, str(script), str(data), str(out), str(workers), str(steps)],
        env={**os.environ, "PYTHONPATH": str(source)},
        stderr=subprocess.PIPE,
        text=True,
    )


def _finish(process: subprocess.Popen) -> tuple[int, str]:
    _, errors = process.communicate(timeout=240)
    assert process.returncode in (0, -signal.SIGKILL), errors
    return process.returncode, errors


def _content(out: Path) -> dict[str, object]:
    """Everything that seeds leave, without what a clock measured."""
    found: dict[str, object] = {str(file.relative_to(out)): file.read_bytes() for file in out.rglob("state.eqx")}
    run = training.load_run(out)
    for seed in run.seeds:
        for line in run.metrics(seed):
            numbers = {name: value for name, value in line.items() if not name.startswith("time/")}
            found[f"line {seed} {line['step']} {sorted(numbers)}"] = numbers
        found[f"evaluation {seed}"] = run.summary(seed)["evaluation"]
    return found


def test_side_by_side_gives_the_bits_of_one_after_another(data: Path, one_after_another: Path, tmp_path: Path):
    out = tmp_path / "run"
    _, errors = _finish(_start(data, out, 2, 40))
    assert _content(out) == _content(one_after_another)
    states = {content for name, content in _content(out).items() if name.endswith("00000040/state.eqx")}
    assert len(states) == 3
    shown = [line for line in errors.splitlines() if "updates/s" in line]
    assert shown and all(line.startswith("seeds 0 1 2: training: ") for line in shown)
    assert "120/120" in shown[-1]


def test_killed_run_keeps_others_out_while_it_lives_and_goes_on_at_once(
    data: Path, one_after_another: Path, tmp_path: Path
):
    out = tmp_path / "run"
    process = _start(data, out, 2, 40_000)
    _until(lambda: all(len(list((out / f"seed-{seed}" / "checkpoints").glob("0*"))) > 2 for seed in (0, 1)), process)
    with pytest.raises(odaf.ConfigError, match="another process is training in it"):
        odaf.resume(out, progress=False)
    process.kill()
    assert _finish(process)[0] == -signal.SIGKILL
    # Made shorter by hand, so that what is left takes a moment.
    for seed in (0, 1):
        for folder in (out / f"seed-{seed}" / "checkpoints").glob("0*"):
            if int(folder.name) > 10:
                shutil.rmtree(folder)
    config = (out / "config.json").read_text()
    (out / "config.json").write_text(config.replace("40000", "40").replace("20000", "20"))
    assert _finish(_start(data, out, 2, 40))[0] == 0
    assert _content(out) == _content(one_after_another)
    assert not list(out.rglob(".writing-*"))


def test_seed_that_fails_lets_the_others_finish_and_is_named(one_after_another: Path, tmp_path: Path):
    out = tmp_path / "run"
    shutil.copytree(one_after_another, out)
    (out / "seed-1" / "checkpoints" / "00000040" / "state.eqx").write_bytes(b"nothing")
    with pytest.raises(odaf.CheckpointError, match=r"seed-1.*size in bytes"):
        odaf.resume(out, 60, workers=2, progress=False)
    assert [summary["step"] for summary in odaf.load_run(out).summary.values()] == [60, 40, 60]


class _Unsendable:
    def open(self, directory, step): ...
    def log(self, step, metrics): ...
    def close(self): ...


def test_settings_that_cannot_work_are_refused(data: Path, tmp_path: Path):
    learner = odaf.BehaviourCloning(hidden_sizes=(8,))
    with pytest.raises(odaf.ConfigError, match="workers: must be at least 1, got 0"):
        odaf.fit(learner, data, steps=2, directory=tmp_path / "run", workers=0)
    logger = _Unsendable()
    logger.open = lambda directory, step: None  # a function without a name cannot be pickled
    with pytest.raises(odaf.ConfigError, match=r"loggers: _Unsendable.*workers=1"):
        odaf.fit(learner, data, steps=2, directory=tmp_path / "run", seeds=(0, 1), workers=2, loggers=(logger,))


def test_number_of_workers_when_nobody_says(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("odaf.runs.side_by_side.cores", lambda: 3)
    assert [default_workers(seeds) for seeds in (1, 2, 5)] == [1, 2, 3]
    assert default_workers(5, cores_each=2) == 1
    monkeypatch.setattr("jax.default_backend", lambda: "gpu")
    assert default_workers(5) == 1
    assert side_by_side(RunSettings(), None, apart=False) is sequential


def test_progress_of_all_seeds_is_one_line(monkeypatch: pytest.MonkeyPatch):
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])

    stream = io.StringIO()
    combined = CombinedProgress({3: 0, 5: 20}, 100, Lines(stream, interval=10.0))
    reports = {seed: SeedReport(seed, combined.receive) for seed in (3, 5)}
    reports[3].start("seed 3: compiling", 0)
    reports[5].start("seed 5: training", 100, 20)
    reports[5].start("seed 5: side model", 1000, 0)
    reports[5].advance(900)  # of something else than updates
    now[0] = 20.0
    reports[3].start("seed 3: training", 100)
    for done in range(10, 101, 10):
        now[0] += 0.15  # not every step is told
        reports[3].advance(done)
    reports[5].start("seed 5: training", 100, 20)
    reports[5].message("seed 5: strange values")
    now[0] = 40.0
    reports[5].advance(50, "return 7.0")
    combined.finish(3)
    combined.finish(5)
    assert stream.getvalue().splitlines() == [
        "seeds 3 5: training: 20/200  seed 5: side model",
        "seed 5: strange values",
        "seeds 3 5: training: 150/200  3 updates/s  0:15 left  seed 5: return 7.0",
        "seeds 3 5: training: 200/200  4 updates/s  seed 5: return 7.0",
    ]


def _until(true, process: subprocess.Popen) -> None:
    deadline = time.monotonic() + 120
    while not true():
        assert process.poll() is None and time.monotonic() < deadline, "nothing happened"
        time.sleep(0.02)
