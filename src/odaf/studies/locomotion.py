"""The locomotion study: learning curves of every learner on Hopper and HalfCheetah, on data recorded on the spot.

One JSON file a run under the results directory and a table drawn from those files. Runs whose file is there are not
repeated; a run that was stopped goes on from its last checkpoint.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from odaf.errors import ConfigError
from odaf.studies.ledger import (
    LOCAL,
    StudyRun,
    chosen_phases,
    grouped,
    measure_missing,
    read_records,
    run_facts,
    train_while_finite,
)

TRANSITIONS = 200_000
DATA_SEED = 0
HIDDEN_SIZES = (256, 256)
EVALUATE_EVERY = 5_000
EPISODES = 10  # while a run trains
FINAL_EPISODES = 20  # at its last checkpoint
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


def plan() -> list[list[StudyRun]]:
    """Every run of the study, the cheap ones that say most first: our default on Hopper, the others there, HalfCheetah,
    parts of the default, what is costly. Within a phase every method has its first seed before any has its second."""

    def runs(methods: Iterable[Method], task: str, steps: int = STEPS, seeds: int = SEEDS) -> list[StudyRun]:
        methods = tuple(methods)
        return [StudyRun(preset, task, seed, steps, changes) for seed in range(seeds) for preset, changes in methods]

    return [
        runs(DEFAULT, HOPPER),
        runs((*OTHERS, *TEN_CRITICS), HOPPER),
        runs((*DEFAULT, *OTHERS, *EDAC), HALFCHEETAH),
        runs(PARTS, HOPPER),
        [
            *runs(COSTLY, HOPPER, FEW_STEPS, seeds=1),
            *runs(EDAC, HOPPER),
            *runs(PAPER, HOPPER),
            *runs(PAPER, HALFCHEETAH),
        ],
    ]


def run(
    out: Path, workers: int = 1, only: Sequence[str] = (), phase: Sequence[int] = (), work: Path | None = None
) -> None:
    """Measure what is missing, then draw the table.

    Args:
        out: directory of the records and `table.md`.
        workers: runs at the same time, each on its own core.
        only: presets or methods to measure; none takes all.
        phase: phases of `plan` to measure, from 1; none takes all.
        work: directory of data and run directories; None takes `runs/locomotion`.

    Raises:
        ConfigError: `only` or `phase` names what the study has not.
    """
    work = Path("runs/locomotion") if work is None else work
    # No run goes on where another stopped, so no worker has to wait for the end of a phase.
    runs = [job for part in chosen_phases(plan(), phase, only) for job in part]
    measure_missing(measure, [runs], out, work, workers=workers, prepare=data_file, summarise=summarise)


def summarise(out: Path) -> None:
    """Draw `table.md` from the records in `out`."""
    (out / "table.md").write_text(table(read_records(out)), encoding="utf-8")


def data_file(work: Path, task: str) -> Path:
    """The recorded set, made when it is not there yet. Its name says how large it is and from which seed."""
    path = work / f"{task}-{TRANSITIONS}-seed{DATA_SEED}.h5"
    if not path.exists():
        from odaf.environments.locomotion_data import generate

        path.parent.mkdir(parents=True, exist_ok=True)
        generate(task, TRANSITIONS, DATA_SEED).save(path)
    return path


def learner(study: StudyRun) -> Any:
    """The preset with its values for the task, where it has some, then networks of equal size, then the changes."""
    from odaf.runs import presets

    task = study.task if study.task in presets.tasks(study.preset) else None
    return presets.load(study.preset, {"hidden_sizes": HIDDEN_SIZES, **dict(study.changes)}, task=task)


def measure(study: StudyRun, work: Path) -> dict[str, Any]:
    """Train (or continue) one run and return its record."""
    from odaf.environments.reference_returns import reference_of
    from odaf.evaluation import Rollouts
    from odaf.runs.evaluate import evaluate

    rollouts = Rollouts(episodes=EPISODES, every=EVALUATE_EVERY)
    run = train_while_finite(study, work, learner(study), data_file(work, study.task), rollouts)
    environment = run.data["environment"]["id"]
    reference = reference_of(environment)
    if reference is None:
        raise ConfigError(f"{run.directory}: {environment} has no reference returns, so it has no normalised score")
    facts = run_facts(study, run)
    if facts["final"] is not None:
        score = evaluate(run.directory, episodes=FINAL_EPISODES).by_seed[0]
        facts["final"] = {
            "step": score.step,
            "episodes": FINAL_EPISODES,
            "mean_return": score.mean_return,
            "std_return": score.std_return,
            "normalised_score": reference.normalise(score.mean_return),
            "returns": list(score.returns),
        }
    for evaluation in facts["evaluations"]:
        evaluation["normalised_score"] = reference.normalise(evaluation["mean_return"])
    logged = run.data["summary"]["provenance"]["statistics"]
    return {
        "study": "locomotion",
        "task": study.task,
        "environment": environment,
        "command": "odaf reproduce locomotion",
        **facts,
        "data": {
            **facts["data"],
            "same_set": f"odaf data generate {study.task} --transitions {TRANSITIONS} --seed {DATA_SEED} --out FILE",
            "transitions": logged["transitions"],
            "whole_episodes": logged["whole_episodes"],
            "mean_return": logged.get("mean"),
            "best_return": logged.get("best"),
            "normalised_score": logged.get("normalised_mean"),
        },
    }


def table(records: Sequence[dict[str, Any]]) -> str:
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
        where = f"| {task} | {environment} | {LOCAL}, {' and '.join(prints)} "
        lines.append(_data_row(where, group[0]["data"]))
        methods = grouped(
            group, lambda record: (record["method"] != "behaviour-cloning", record["method"], record["steps"])
        )
        lines += [_row(where, runs) for runs in methods.values()]
    return "\n".join(lines) + "\n"


def _rows_of(data: dict[str, Any]) -> str:
    """What tells one recorded set from another: figures to the last digit. A fingerprint covers the notes as well, so
    the same rows have another one once a note of how their policy was trained is worded differently."""
    return repr([data[figure] for figure in ("transitions", "whole_episodes", "mean_return", "best_return")])


def _data_row(where: str, data: dict[str, Any]) -> str:
    if data["mean_return"] is None:
        score = mean = "unknown"
    else:
        score, mean = f"{data['normalised_score']:.1f}", f"{data['mean_return']:,.1f}"
    return f"{where}| the data themselves ({data['whole_episodes']:,} episodes) | | | {score} | | | {mean} | | |"


def _row(where: str, group: Sequence[dict[str, Any]]) -> str:
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
