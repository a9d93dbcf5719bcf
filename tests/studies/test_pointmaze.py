"""The stitching study's plan; its runs and records are tested with the work of training."""

from odaf.studies import pointmaze
from odaf.studies.training import Training


def test_the_plan_is_what_the_page_says() -> None:
    phases = pointmaze.plan()
    first = [(job.do.method, job.do.seed) for job in phases[0].jobs if isinstance(job.do, Training)]
    methods = ("odaf", "odaf-without-outcome", "behaviour-cloning")
    assert first == [(method, seed) for seed in range(4) for method in methods]
    longer = [job for phase in phases for job in phase.jobs if job.name.endswith("-50000")]
    assert [job.after for job in longer] == [(job.name.replace("-50000", "-20000"),) for job in longer]
    assert len(longer) == 4
    for phase in phases:
        for job in phase.jobs:
            assert isinstance(job.do, Training)
            assert job.do.task.evaluation.episodes == 50 and job.do.task.field == "maze"
