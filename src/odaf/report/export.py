"""The comparison table as data: CSV, JSON, or a LaTeX table for a paper. Needs no drawing library."""

import csv
import io
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import odaf
from odaf.data.writing import write_text
from odaf.environments.reference_returns import reference_of
from odaf.errors import ConfigError
from odaf.report.names import listed, names_of
from odaf.report.records import LOCAL, RunRecord, data_prints, environment_name, find_runs, read_run
from odaf.report.scores import Score, decimals, score
from odaf.training.files import finite

FIELDS = (
    "name",
    "preset",
    "directory",
    "data",
    "fingerprint",
    "origin",
    "environment",
    "updates",
    "seeds",
    "episodes",
    "mean",
    "low",
    "high",
    "normalised_mean",
    "normalised_low",
    "normalised_high",
    "success",
    "stitched",
    "seconds",
    "updates_per_second",
    "version",
)
"""What stands in every row, in this order; empty (JSON: null) where a run does not tell."""

STATISTIC = (
    "mean: over seeds of each seed's mean return at its last checkpoint; low, high: Student's t 95 % interval over "
    "seeds, absent below two seeds; seconds and updates_per_second: mean over seeds, without evaluation"
)
LATEX_START = "% Table made by odaf"

_ESCAPES = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': "''",
    "…": r"\ldots{}",
    "–": "--",
}


def write(
    run_directories: Sequence[Path],
    out: Path,
    layout: str,
    title: str | None = None,
    names: Sequence[str] | None = None,
) -> Path:
    """Writes the table of runs as `layout`: "csv", "json" or "latex"; see `odaf.report.build`."""
    out = Path(out)
    if out.is_dir():
        raise ConfigError(f"{out}: is a folder; name the file to write")
    runs = [read_run(directory) for directory in find_runs(run_directories)]
    scores = [score(run, name) for run, name in zip(runs, names_of(runs, names), strict=True)]
    if layout == "latex":
        text = _as_latex(runs, scores, title)
    else:
        text = (_as_csv if layout == "csv" else _as_json)(runs, scores)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_text(out, text)
    return out


def row(run: RunRecord, entry: Score, fingerprint: str | None) -> dict[str, Any]:
    """One run under the names of `FIELDS`; None for what it does not tell."""
    low, high = entry.interval or (None, None)
    versions = run.machine.get("versions")
    return dict(
        zip(
            FIELDS,
            (
                entry.label,
                run.config.get("preset"),
                str(run.directory),
                run.data.get("path"),
                fingerprint,
                run.origin or None,
                None if run.evaluation_environment is None else environment_name(run.evaluation_environment),
                entry.step,
                entry.evaluated,
                entry.episodes,
                entry.mean,
                low,
                high,
                *_normalised(run, (entry.mean, low, high)),
                entry.success_rate,
                entry.stitched_rate,
                entry.train_seconds,
                entry.updates_per_second,
                versions.get("odaf") if isinstance(versions, Mapping) else None,
            ),
            strict=True,
        )
    )


def _normalised(run: RunRecord, values: Sequence[float | None]) -> list[float | None]:
    identity = run.evaluation_environment_id
    reference = None if identity is None else reference_of(identity)
    return [None if reference is None or value is None else reference.normalise(value) for value in values]


def _rows(runs: Sequence[RunRecord], scores: Sequence[Score]) -> list[dict[str, Any]]:
    table = zip(runs, scores, data_prints(runs), strict=True)
    return [row(run, entry, fingerprint) for run, entry, fingerprint in table]


def _as_csv(runs: Sequence[RunRecord], scores: Sequence[Score]) -> str:
    target = io.StringIO()
    writer: csv.DictWriter[str] = csv.DictWriter(target, FIELDS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(_rows(runs, scores))
    return target.getvalue()


def _as_json(runs: Sequence[RunRecord], scores: Sequence[Score]) -> str:
    rows = _rows(runs, scores)
    for run, entry in zip(runs, rows, strict=True):
        entry["by_seed"] = [
            {
                "seed": seed.seed,
                "updates": found.step,
                "mean": found.mean,
                "episodes": found.episodes,
                "returns": None if found.returns is None else found.returns.tolist(),
            }
            for seed in run.seeds
            if (found := seed.evaluation) is not None
        ]
    content = {"table": "odaf report", "version": odaf.__version__, "statistic": STATISTIC, "runs": rows}
    return json.dumps(finite(content), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def escaped(text: str) -> str:
    """Text as LaTeX prints it, letter by letter."""
    return "".join(_ESCAPES.get(letter, letter) for letter in " ".join(text.split()))


def _as_latex(runs: Sequence[RunRecord], scores: Sequence[Score], title: str | None) -> str:
    places = decimals([value for entry in scores for value in (entry.mean, *entry.seed_means)])
    scored = [_normalised(run, (entry.mean, *(entry.interval or ()))) for run, entry in zip(runs, scores, strict=True)]
    columns = {
        "Method": [escaped(entry.label) for entry in scores],
        "Mean return": [_number(entry.mean, places) for entry in scores],
        r"95\,\% interval": [_spread(entry, places) for entry in scores],
        "Normalised score": [_number(values[0], 1) for values in scored],
        "Success": [_share(entry.success_rate) for entry in scores],
        "Stitched": [_share(entry.stitched_rate) for entry in scores],
    }
    if not any(entry.interval for entry in scores):
        columns["Spread"] = columns.pop(r"95\,\% interval")
    seeds = sorted({entry.evaluated for entry in scores})
    if len(seeds) > 1:
        columns["Seeds"] = [str(entry.evaluated) for entry in scores]
    columns = {name: cells for name, cells in columns.items() if name in ("Method", "Mean return") or any(cells)}
    lines = [" & ".join(cells) + r" \\" for cells in zip(*columns.values(), strict=True)]
    return "\n".join(
        [
            rf"{LATEX_START} {odaf.__version__}; the preamble needs \usepackage{{booktabs}}",
            r"\begin{table}",
            r"  \centering",
            rf"  \caption{{{_caption(runs, scores, seeds, title)}}}",
            rf"  \begin{{tabular}}{{l{'r' * (len(columns) - 1)}}}",
            r"    \toprule",
            f"    {' & '.join(columns)} " + r"\\",
            r"    \midrule",
            *(f"    {line}" for line in lines),
            r"    \bottomrule",
            r"  \end{tabular}",
            r"\end{table}",
            "",
        ]
    )


def _caption(runs: Sequence[RunRecord], scores: Sequence[Score], seeds: Sequence[int], title: str | None) -> str:
    """What the numbers are: statistic, seeds, episodes, environments of normalised scores, origin of the data."""
    number = f"{seeds[0]} seed{'s' if seeds[0] != 1 else ''}" if len(seeds) == 1 else f"{seeds[0]} to {seeds[-1]} seeds"
    begin = "" if title is None else f"{title.rstrip('.')}. "
    told = [f"{begin}Mean return at the last checkpoint over {number}"]
    if any(entry.interval for entry in scores):
        told.append("the interval is Student's t over the seeds' means")
    if any(entry.interval is None and entry.mean is not None for entry in scores):
        told.append("± is the standard deviation over the episodes of one seed")
    episodes = sorted({entry.episodes for entry in scores})
    told.append(f"{' to '.join(str(count) for count in dict.fromkeys((episodes[0], episodes[-1])))} episodes a run")
    played = {run.evaluation_environment_id for run in runs if any(_normalised(run, (0.0,)))}
    if played:
        where = ", ".join(sorted(map(str, played)))
        told.append(f"normalised scores in {where}: 0 is a random policy's, 100 an expert's")
    local = [entry.label for run, entry in zip(runs, scores, strict=True) if run.origin]
    if local:
        told.append(LOCAL if len(local) == len(runs) else f"{LOCAL}: {listed(local)}")
    if len(set(data_prints(runs)) - {None}) > 1:
        told.append("the runs saw different data")
    return re.sub("±", r"$\\pm$", escaped("; ".join(told))) + "."


def _number(value: float | None, places: int) -> str:
    return "" if value is None else f"${value:.{places}f}$"


def _share(rate: float | None) -> str:
    return "" if rate is None else rf"{100 * rate:.0f}\,\%"


def _spread(entry: Score, places: int) -> str:
    if entry.interval is not None:
        return f"${entry.interval[0]:.{places}f}$ to ${entry.interval[1]:.{places}f}$"
    return "" if entry.std is None else rf"$\pm\,{entry.std:.{places}f}$"
