"""Jobs on a Ray cluster: a worker that dies, news, failures and the end of the time; and what is refused."""

import io
import math
import os
import signal
import socket
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import odaf
from golden import jobs
from odaf.errors import ConfigError
from odaf.studies import on_ray
from odaf.studies.executor import Executor
from odaf.studies.job import Job, Record
from odaf.studies.ledger import Ledger
from odaf.studies.news import Display
from odaf.studies.on_ray import OnRay, joined
from odaf.studies.perform import perform
from odaf.studies.training import Training
from odaf.training.progress import ProgressReport
from studies.killed import small_study
from studies.test_killed_study import records, times_resumed


@pytest.fixture(scope="module")
def cluster() -> Iterator[OnRay]:
    """Two workers, whatever this machine has."""
    pytest.importorskip("ray", reason="needs the extra `ray`, which is not part of `dev`")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
        patch.setenv("RAY_worker_niceness", "0")  # beside other tests, workers that give way to all would take minutes
        patch.setattr("odaf.studies.on_ray.cores", lambda: 2)
        with joined("local") as executor:
            yield executor


def run(cluster: OnRay, function: Any, first: list[Any], heard: list[Any] | None = None, **options: Any) -> list[Any]:
    settings = {"then": lambda job, result: [], "receive": [].append if heard is None else heard.append, "until": None}
    return sorted(cluster.run(function, first, **{**settings, **options}))


def test_without_ray_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with (
        pytest.raises(ConfigError, match=r'--ray: needs ray .* pip install "odaf\[ray\]" on every machine'),
        joined("local"),
    ):
        pass


def test_another_odaf_does_no_job() -> None:
    with pytest.raises(
        ConfigError, match=f"3: a machine of the cluster has odaf {odaf.__version__}, .* has 0.0.1; install"
    ):
        on_ray._done(math.factorial, 3, None, "0.0.1")


def test_where_nobody_listens_no_minutes_are_spent() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # bound, and not listening
        with pytest.raises(ConnectionRefusedError):
            on_ray._answers(f"127.0.0.1:{taken.getsockname()[1]}")
    on_ray._answers("auto")


def test_results_come_back_and_news_before_them(cluster: OnRay) -> None:
    assert isinstance(cluster, Executor) and cluster.width == 2
    heard: list[Any] = []
    found = run(cluster, jobs.halve, [8], heard, then=lambda job, result: [result] if result > 1 else [])
    assert found == [(2, 1), (4, 2), (8, 4)]
    assert heard == [(8, "half of"), (8, 8), (4, "half of"), (4, 4), (2, "half of"), (2, 2)]


def test_what_a_job_raises_is_raised_here(cluster: OnRay) -> None:
    with pytest.raises(ValueError, match="negative") as caught:
        run(cluster, math.factorial, [-1, 2])
    assert type(caught.value) is ValueError


def test_what_still_runs_at_the_end_of_the_time_is_stopped(cluster: OnRay) -> None:
    began = time.monotonic()
    assert run(cluster, jobs.sleep, [600.0, 601.0, 602.0], until=began + 1.0) == []
    assert run(cluster, jobs.sleep, [0.1, 0.2]) == [(0.1, 0.1), (0.2, 0.2)]  # both workers are free again
    assert time.monotonic() - began < 300.0


class Killing:
    """A report that kills the process once it hears of an update."""

    def __init__(self, report: ProgressReport, at: int):
        self._report, self._at = report, at

    def start(self, *arguments: Any, **options: Any) -> None:
        self._report.start(*arguments, **options)

    def advance(self, done: int, note: str = "") -> None:
        if done >= self._at:
            os.kill(os.getpid(), signal.SIGKILL)
        self._report.advance(done, note)

    def message(self, text: str) -> None:
        self._report.message(text)

    def close(self) -> None:
        self._report.close()


@dataclass(frozen=True)
class Dying(Training):
    """A training whose worker is killed in the middle, the first time."""

    def do(self, place: Path, progress: ProgressReport) -> Record:
        died = place / "died"
        if died.exists():
            return super().do(place, progress)
        died.touch()
        return super().do(place, Killing(progress, 6))


@pytest.mark.slow
def test_a_worker_is_killed_in_the_middle_and_the_records_are_the_same(cluster: OnRay, tmp_path: Path) -> None:
    plan = small_study()
    first, *others = plan.jobs()
    assert isinstance(first.do, Training)
    dying = [Job(first.name, Dying(**vars(first.do))), *others]
    for name, todo in (("unbroken", plan.jobs()), ("killed", dying)):
        place, said = tmp_path / name, io.StringIO()
        perform(Ledger(plan, place / "ledger"), todo, place / "work", cluster, Display("small", said))
        assert "[3/3] " in said.getvalue()
    assert (tmp_path / "killed" / "work" / "died").exists()
    # The longer of the trainings goes on from the shorter in both; the one that died went on from its last checkpoint.
    assert (times_resumed(tmp_path / "unbroken"), times_resumed(tmp_path / "killed")) == (1, 2)
    unbroken, killed = records(tmp_path / "unbroken" / "ledger"), records(tmp_path / "killed" / "ledger")
    assert len(unbroken) == 5 and killed == unbroken


def test_a_job_that_kills_every_worker_is_named(cluster: OnRay) -> None:
    with pytest.raises(ConfigError, match=r"9: begun 4 times, and its worker was lost each time .* memory"):
        run(cluster, signal.raise_signal, [signal.SIGKILL.value])
