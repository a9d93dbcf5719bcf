"""The default study: which candidate is our default, chosen on some logs and judged on others, and what carries it.

One protocol, fixed beforehand. Candidates are tried on four tuning logs of seeds 0 and 1; the choice among them is a
rule on these records. Judged are default and rivals on verdict logs of another seed, with seeds of their own: the score
of the last checkpoint, its steadiness (standard deviation over the evaluations of the second half), and seconds.
"""

from collections.abc import Sequence

from odaf.studies import default_outcomes, default_scores, default_table
from odaf.studies.default_methods import (
    ABLATION_SEEDS,
    CANDIDATES,
    DEFAULT,
    MORE_SEEDS,
    RIVALS,
    SLOW,
    TUNING_SEEDS,
    TUNING_STEPS,
    VERDICT_SEEDS,
    ablation_tasks,
    ablations,
    first_verdict_tasks,
    other_verdict_tasks,
    training,
    tuning_tasks,
)
from odaf.studies.job import Phase, Study
from odaf.studies.of_policy import OfPolicy, phase_of
from odaf.studies.robots import Method
from odaf.studies.task import Task
from odaf.studies.training import Training, phases_of

EVERY: tuple[Method, ...] = (DEFAULT, *RIVALS)
QUICK = tuple(method for method in EVERY if method not in SLOW)


def plan() -> list[Phase]:
    """Tuning first; of the verdict what two cores can do before what needs lanes; a policy is trained once."""

    def tuning(seed: int) -> list[Training]:
        return [training(each, task, seed, TUNING_STEPS) for task in tuning_tasks(seed) for each in CANDIDATES]

    def verdict(tasks: Sequence[Task], seeds: Sequence[int], methods: Sequence[Method] = EVERY) -> list[Training]:
        return [training(each, task, seed) for seed in seeds for task in tasks for each in methods]

    first, others = first_verdict_tasks(), other_verdict_tasks()
    parts = [training(each, task, seed) for seed in ABLATION_SEEDS for task in ablation_tasks() for each in ablations()]
    phases = _once(
        *((f"tuning, seed {seed}: candidates on four logs", tuning(seed)) for seed in TUNING_SEEDS),
        ("verdict, two seeds: Hopper's logs, one of each other robot", verdict(first, VERDICT_SEEDS, QUICK)),
        ("the same: two slow rivals", verdict(first, VERDICT_SEEDS)),
        ("verdict, two seeds: two mazes, the other robots' logs", verdict(others, VERDICT_SEEDS)),
        ("verdict, two more seeds (lanes): all logs", verdict([*first, *others], MORE_SEEDS)),
        ("ablation, eight seeds on three logs: the default without each of its parts", parts),
        ("outcomes: Hopper's logs of 50 to 90 % random rows", default_outcomes.mixtures(default_outcomes.SEEDS)),
    )
    seeds: list[tuple[str, list[OfPolicy]]] = [
        ("outcomes: knocks and attacks, two seeds", default_outcomes.works(default_outcomes.SEEDS)),
        ("outcomes: knocks and attacks, two more seeds", default_outcomes.works(default_outcomes.LATER_SEEDS)),
    ]
    for title, works in seeds:
        phases.append(phase_of(title, works, phases))
    return phases


def _once(*parts: tuple[str, list[Training]]) -> list[Phase]:
    """Phases in which a training that an earlier one has does not come again."""
    seen: set[str] = set()
    kept: list[tuple[str, list[Training]]] = []
    for title, trainings in parts:
        fresh = {one.name: one for one in trainings if one.name not in seen}
        seen |= fresh.keys()
        kept.append((title, [*fresh.values()]))
    return phases_of(*kept)


STUDY = Study(
    "default",
    "which candidate is the default, chosen on four logs and judged on others, and what carries it",
    plan,
    {
        "table.md": default_table.table,
        "summary.json": default_scores.summary,
        "tuning.md": default_table.tuning,
        "tuning.json": default_scores.tuning_summary,
        "ablation.md": default_table.ablation,
        "outcomes.md": default_outcomes.table,
        "outcomes.json": default_outcomes.summary,
    },
    {"figure.png": default_table.figure},
)
