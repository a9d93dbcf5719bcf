"""What jobs cost: measured, else from like jobs, else guessed; what is done already costs nothing."""

from pathlib import Path

import pytest

from odaf.studies.cost import Costs, minutes, seconds_of
from odaf.studies.job import Job
from odaf.studies.logs import MazeLog
from odaf.studies.task import Evaluation, Task
from odaf.studies.training import Training

TASK = Task(MazeLog("stitch"), Evaluation())


def run(preset: str, seed: int, steps: int, **changes: object) -> Job:
    training = Training(preset, TASK, seed, steps, tuple(changes.items()))
    return Job(training.name, training)


def test_own_record_then_the_most_alike_then_a_guess() -> None:
    measured = [
        (run("odaf", 0, 100), {"seconds": {"total": 50.0}}),
        (run("odaf", 1, 100), {"seconds": {"total": 70.0}}),
        (run("odaf", 1, 100, num_critics=50), {"seconds": {"total": 900.0}}),
        (run("sac-n", 0, 100), {"seconds": None}),
    ]
    costs = Costs(measured)
    assert costs.whole(run("odaf", 0, 100)) == 50.0
    assert costs.whole(run("odaf", 7, 200)) == pytest.approx(120.0)  # the median of two seeds, twice as many updates
    assert costs.whole(run("odaf", 3, 100, num_critics=50)) == pytest.approx(900.0)
    assert costs.whole(run("odaf", 3, 100, radius=1.0)) == pytest.approx(70.0)  # the preset's, whatever is changed
    assert costs.whole(run("sac-n", 0, 1000)) == pytest.approx(25.0)


def test_a_longer_run_costs_what_it_adds(tmp_path: Path) -> None:
    short, long, other = run("odaf", 0, 100), run("odaf", 0, 300), run("odaf", 1, 100)
    costs = Costs([(short, {"seconds": 30.0}), (long, {"seconds": 90.0})])
    assert costs.total([short, long, other]) == pytest.approx(30.0 + 60.0 + 30.0)
    assert costs.total([long]) == pytest.approx(90.0)  # its predecessor's directory may be gone
    assert isinstance(long.do, Training)
    (long.do.directory(tmp_path) / "seed-0" / "checkpoints" / "00000200").mkdir(parents=True)
    assert costs.total([long], tmp_path) == pytest.approx(30.0)
    assert costs.left(short, tmp_path) == 0.0


def test_durations_as_a_person_would_say_them() -> None:
    assert [minutes(s) for s in (0.4, 89, 91, 5_300, 5_500)] == ["0 s", "89 s", "2 min", "88 min", "1.5 h"]
    assert seconds_of({"seconds": {"total": 3}}) == 3.0 and seconds_of({}) is None
