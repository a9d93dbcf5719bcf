"""The locomotion study: learning curves of every learner on Hopper and HalfCheetah, on data recorded on the spot."""

from collections.abc import Iterable, Sequence
from typing import Any

from odaf.studies.first_form import COMMON, first_form
from odaf.studies.job import Phase, Record, Study
from odaf.studies.logs import LOCAL, RecordedLog, origin_of
from odaf.studies.tables import grouped
from odaf.studies.task import Evaluation, Task
from odaf.studies.training import Training, phases_of

FINAL_EPISODES = 20  # at the last checkpoint
STEPS = 50_000
FEW_STEPS = 10_000
SEEDS = 2
HOPPER, HALFCHEETAH = "hopper-medium", "halfcheetah-medium"

Method = tuple[str, tuple[tuple[str, Any], ...]]

# Our default for such tasks, beside the yardstick.
DEFAULT: tuple[Method, ...] = (("behaviour-cloning", ()), ("odaf-locomotion", ()))
# What each of its parts is worth: the same with one of them taken out, or with random networks beside the critics.
PARTS: tuple[Method, ...] = (
    ("odaf-locomotion-without-outcome", ()),
    ("odaf-locomotion", (("prior_scale", 1.0),)),
    ("odaf-locomotion", (("return_steps", 1),)),
    ("odaf-locomotion", (("warm_start", "none"), ("target_entropy", -1.0))),  # about what the warm start measures
    ("odaf-locomotion", (("reward_scale", 1.0),)),
)
OTHERS: tuple[Method, ...] = (
    ("sac-n", ()),
    ("odaf", ()),
    ("odaf-without-outcome", ()),
    ("odaf-pessimistic", ()),
    ("osr-10", ()),
)
EDAC: tuple[Method, ...] = (("edac", ()),)
TEN_CRITICS: tuple[Method, ...] = (("edac", (("num_critics", 10),)),)  # its task preset for Hopper has fifty
# Twenty draws an update, or several losses over many draws.
PAPER: tuple[Method, ...] = (("odaf-paper", ()),)
COSTLY: tuple[Method, ...] = (("pbrl", ()), ("rorl", ()), ("odaf-rorl", ()), ("odaf-demo", ()))


def locomotion_task(name: str) -> Task:
    """Walking or hopping from 200,000 transitions of the sets' first edition; all networks are of one size."""
    return Task(
        RecordedLog(name, transitions=200_000, edition=1),
        Evaluation(every=5_000, episodes=10, final_episodes=FINAL_EPISODES),
        score="normalised_score",
        common=(("hidden_sizes", (256, 256)), *COMMON),
    )


def plan() -> list[Phase]:
    """The cheap ones that say most first. Within a phase every method has its first seed before any has its second."""

    def runs(methods: Iterable[Method], task: str, steps: int = STEPS, seeds: int = SEEDS) -> list[Training]:
        whole, methods = locomotion_task(task), tuple(methods)
        return [
            Training(preset, whole, seed, steps, changes, first_form(preset))
            for seed in range(seeds)
            for preset, changes in methods
        ]

    return phases_of(
        ("Hopper: our default beside behaviour cloning", runs(DEFAULT, HOPPER)),
        ("Hopper: the other learners", runs((*OTHERS, *TEN_CRITICS), HOPPER)),
        ("HalfCheetah: all of these", runs((*DEFAULT, *OTHERS, *EDAC), HALFCHEETAH)),
        ("Hopper: our default with one part changed", runs(PARTS, HOPPER)),
        (
            "what is costly: losses over many draws, fifty critics, the paper's form",
            [
                *runs(COSTLY, HOPPER, FEW_STEPS, seeds=1),
                *runs(EDAC, HOPPER),
                *runs(PAPER, HOPPER),
                *runs(PAPER, HALFCHEETAH),
            ],
        ),
    )


def table(records: Sequence[Record]) -> str:
    """Markdown table: for every task the data, behaviour cloning, then a row for every method over its seeds."""
    lines = [
        f"Scores on {LOCAL}; last checkpoint, deterministic policy, {FINAL_EPISODES} episodes a seed. Scores are",
        "normalised, 0 for a random policy and 100 for an expert, and belong to the environment named; the raw return",
        "stands beside them. Two fingerprints in one row: the same rows, recorded with differently worded notes.",
        "Intervals are 95 % Student intervals over seeds. `on the way` is the mean score of all evaluations while the",
        "runs trained: a policy that comes and goes has less there than at its end. `updates` are those made; where a",
        "run diverged its method has no score. The row of the data is the mean of their whole episodes. Made by",
        "`odaf reproduce locomotion` from the records in this folder.",
        "",
        "| task | environment | data | method | updates | seeds | score | 95 % interval | on the way | return "
        "| updates/s | hours |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    sets = grouped(records, lambda record: (record["task"], record["environment"], _rows_of(record["data"])))
    for (task, environment, _), group in sets.items():
        prints = sorted({record["data"]["sha256"][:8] for record in group})
        where = f"| {task} | {environment} | {origin_of(group[0]['data'])}, {' and '.join(prints)} "
        lines.append(_data_row(where, group[0]["data"]))
        methods = grouped(
            group, lambda record: (record["method"] != "behaviour-cloning", record["method"], record["steps"])
        )
        lines += [_row(where, runs) for runs in methods.values()]
    return "\n".join(lines) + "\n"


def _rows_of(data: Record) -> str:
    """What tells one recorded set from another: figures to the last digit. A fingerprint covers the notes as well, so
    the same rows have another one once a note of how their policy was trained is worded differently."""
    return repr([data[figure] for figure in ("transitions", "whole_episodes", "mean_return", "best_return")])


def _data_row(where: str, data: Record) -> str:
    if data["mean_return"] is None:
        score = mean = "unknown"
    else:
        score, mean = f"{data['normalised_score']:.1f}", f"{data['mean_return']:,.1f}"
    return f"{where}| the data themselves ({data['whole_episodes']:,} episodes) | | | {score} | | | {mean} | | |"


def _row(where: str, group: Sequence[Record]) -> str:
    """One method's row: `group` are its seeds."""
    from odaf.evaluation.statistics import t_interval

    asked, made = group[0]["steps"], sorted({record["updates"] for record in group})
    updates = f"{asked:,}" if made == [asked] else f"{' and '.join(f'{count:,}' for count in made)} of {asked:,}"
    lost = sum(record["final"] is None for record in group)
    if lost:
        score = f"{lost} of {len(group)} diverged | | | "
    else:
        scores = t_interval([record["final"]["normalised_score"] for record in group])
        interval = f"[{scores.low:.1f}, {scores.high:.1f}]" if scores.count > 1 else "one seed"
        curve = _mean([point["normalised_score"] for record in group for point in record["evaluations"]])
        mean_return = _mean([record["final"]["mean_return"] for record in group])
        score = f"{scores.mean:.1f} | {interval} | {curve:.1f} | {mean_return:,.1f} "
    speed = _mean([record["updates_per_second"] for record in group])
    hours = _mean([record["seconds"]["total"] for record in group]) / 3600
    return f"{where}| {group[0]['method']} | {updates} | {len(group)} | {score}| {speed:.1f} | {hours:.2f} |"


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


STUDY = Study(
    "locomotion",
    "learning curves of every learner on Hopper and HalfCheetah data made on the spot",
    plan,
    {"table.md": table},
)
