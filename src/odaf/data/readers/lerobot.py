"""Reader of LeRobot folders: Parquet tables under `data/`, described in `meta/info.json`; versions 2 and 3."""

import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import polars as pl

from odaf.data.log import Log
from odaf.data.readers import table_files, table_sources, tables
from odaf.data.readers.row_order import RATE_TOLERANCE, OnGap
from odaf.data.readers.table_cells import OnMissing
from odaf.data.readers.table_meaning import Meaning
from odaf.data.readers.table_sources import Table
from odaf.data.validation import Bounds
from odaf.errors import DatasetError

REWARD = "next.reward"
DONE = "next.done"
TIME = "timestamp"
FRAME = "frame_index"
EPISODE = "episode_index"


def read(
    path: str | os.PathLike[str],
    *,
    observations: Sequence[str] = ("observation.state",),
    actions: Sequence[str] = ("action",),
    reward: str | float = REWARD,
    terminated: str | Literal[False] | None = DONE,
    time: str = TIME,
    time_step: float | None = None,
    infos: Sequence[str] = (),
    action_bounds: Bounds | None = None,
    units: Mapping[str, str] | None = None,
    on_gap: OnGap = "break",
    on_missing: OnMissing = "error",
) -> Log:
    """The log in a LeRobot folder; messages number its frames from 0 through all files.

    Version 2 has one file an episode, version 3 several episodes a file; both are read in the order of their names.
    The last frame of an episode has no successor: it is kept where the task ended there, else the dataset drops it.
    Images and videos are not read. The numbers in a column carry the names of `meta/info.json`, where it has them.

    Args:
        path: the folder that holds `data` and `meta`.
        observations: columns of what was seen.
        actions: columns of what was done.
        reward: the column of what the action of the same frame earned, or a number that every frame earned. Many
            folders have none.
        terminated: the column that says where the task ended; `next.done` counts only where the folder has it. False
            or None: no task ever ended, every episode was cut.
        time: the column of times; without time stamps, the number of the frame counts.
        time_step: the usual time between frames. None takes it from `fps` in `meta/info.json`, which the time stamps
            must bear out; frames counted by number are 1 apart.
        infos: further columns of numbers to keep beside the rows.
        action_bounds: {action: (low, high)} or {column: (low, high)} or (low, high). None takes them from the data.
        units: {column: unit}.
        on_gap: as in `odaf.data.readers.tables.read`.
        on_missing: as in `odaf.data.readers.tables.read`.

    Raises:
        DatasetError: the folder is of another layout or version, a file of it is damaged, a column is missing, or the
            table is refused as in `odaf.data.readers.tables.read`.
    """
    path = Path(path)
    source = os.fspath(path)
    info = _info(path, source)
    files = sorted(file for file in path.glob("data/chunk-*/*.parquet") if not table_files.is_companion(file.name))
    if not files:
        raise DatasetError(f"{source}: holds no data/chunk-*/*.parquet; name the folder that has 'data' and 'meta'")
    names = table_sources.parquet_table(files[0]).names
    if terminated == DONE and DONE not in names:
        terminated = None
    if reward == REWARD and REWARD not in names:
        raise DatasetError(
            f"{source}: has no column '{REWARD}', as many recorded demonstrations; there are {', '.join(names)}",
            remedies=["pass reward=0.0 for cloning", "name another column with reward="],
        )
    if time == TIME and TIME not in names:
        time = FRAME
    meaning = Meaning(
        observations=observations,
        actions=actions,
        reward=reward,
        episode=EPISODE,
        terminated=terminated or None,
        time=time,
        time_step=(1.0 if time == FRAME else 1.0 / info["fps"]) if time_step is None else time_step,
        infos=infos,
        action_bounds=action_bounds,
        units=units,
        on_gap=on_gap,
        on_missing=on_missing,
    )
    meaning.check(source)
    frame = _joined(files, source, meaning.roles(source, names).columns)
    if time_step is None and time != FRAME:
        _refuse_another_rate(source, frame, time, info["fps"], names)
    facts = {name: info[name] for name in ("codebase_version", "robot_type", "fps") if name in info}
    table = Table(
        source,
        "lerobot",
        names,
        frame.height,
        frame.get_column,
        facts={**facts, "files": len(files)},
        parts={**_parts(info["features"], observations), **_parts(info["features"], actions)},
    )
    log = tables.build(table, meaning)
    return replace(log, findings=(*log.findings, *_doubts(log, info, frame)))


def _info(path: Path, source: str) -> dict[str, Any]:
    """What `meta/info.json` says: `features` by column, and `fps`."""
    file = path / "meta" / "info.json"
    try:
        info = json.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise DatasetError(f"{source}: no meta/info.json can be read ({error}); name the folder that has it") from error
    except (ValueError, RecursionError) as error:
        raise DatasetError(f"{file}: is not JSON ({error}); copy the folder again") from error
    if not isinstance(info, dict) or not isinstance(info.get("features"), dict):
        raise DatasetError(f"{file}: does not describe the 'features' of a LeRobot folder; copy it again")
    version = info.get("codebase_version")
    if not isinstance(version, str) or not version.startswith(("v2.", "v3.")):
        raise DatasetError(
            f"{file}: codebase_version is {version!r}; this reads versions 2 and 3, so convert it with LeRobot's tools"
        )
    fps = info.get("fps")
    if isinstance(fps, bool) or not isinstance(fps, (int, float)) or not 0.0 < fps < float("inf"):
        raise DatasetError(f"{file}: fps is {fps!r}; it must be the number of frames a second")
    return info


def _joined(files: Sequence[Path], source: str, names: Sequence[str]) -> pl.DataFrame:
    """The named columns of all files, one file after another."""
    frames: list[pl.DataFrame] = []
    homes: dict[Any, Path] = {}
    for file in files:
        table = table_sources.parquet_table(file)
        table.require(names)
        with table_sources.reading(table.source):
            frames.append(pl.read_parquet(file, columns=list(names), glob=False, hive_partitioning=False))
        if frames[-1][EPISODE].dtype.is_nested():
            continue  # no ids; the table reader says so
        for episode in frames[-1][EPISODE].unique().to_list():
            home = homes.get(episode)
            before = frames[-2][EPISODE] if len(frames) > 1 else frames[-1][EPISODE].clear()
            goes_on = len(before) > 0 and before[-1] == episode == frames[-1][EPISODE][0]
            if home is not None and not goes_on:
                raise DatasetError(
                    f"{source}: episode {episode} lies in {home.name} and again in {file.name}; remove the "
                    "file that is there twice, or give each episode an id of its own in column 'episode_index'"
                )
            homes[episode] = file
    with table_sources.reading(source, "files whose columns differ in type"):
        return pl.concat(frames, how="vertical_relaxed")


def _refuse_another_rate(source: str, frame: pl.DataFrame, time: str, fps: float, names: Sequence[str]) -> None:
    """Raises where the time stamps do not come at the rate that `meta/info.json` promises."""
    stamps, same = frame[time], (frame[EPISODE] == frame[EPISODE].shift(-1)).fill_null(False)
    if not (stamps.dtype.is_float() or stamps.dtype.is_integer()):
        return  # dates; the table reader judges them
    counted = [f'pass time="{FRAME}"'] if FRAME in names else []
    largest = stamps.cast(pl.Float64).abs().max()
    if stamps.dtype == pl.Float32 and isinstance(largest, float) and math.isfinite(largest):
        apart = float(np.spacing(np.float32(largest)))
        if apart > 0.5 / fps:
            raise DatasetError(
                f"{source}: column '{time}' holds times as large as {largest:.6g} in single precision, which are told "
                f"apart only if {apart:.6g} lie between them, and fps in meta/info.json is {fps:g}",
                remedies=[*counted, "store the times in double precision, or from 0 in each episode"],
            )
    steps = (stamps.shift(-1) - stamps).cast(pl.Float64).filter(same)
    step = steps.median()
    if not isinstance(step, float) or not step > 0.0 or abs(step * fps - 1.0) <= RATE_TOLERANCE:
        return  # times that stand still or go back are the table reader's to refuse
    raise DatasetError(
        f"{source}: fps in meta/info.json is {fps:g}, so frames should be {1.0 / fps:.6g} apart, but in column "
        f"'{time}' they are {step:.6g} apart in the median, {1.0 / step:.6g} a second",
        remedies=[f"pass time_step={step:.6g} if the column is right", *counted, "correct fps in meta/info.json"],
    )


def _parts(features: Mapping[str, Any], columns: Iterable[str]) -> dict[str, list[str]]:
    """Names of the numbers in each column; preceded by the column's where two columns use the same."""
    found: dict[str, list[str]] = {}
    for column in columns:
        feature = features.get(column)
        names = feature.get("names") if isinstance(feature, dict) else None
        if isinstance(names, dict) and len(names) == 1:  # {"motors": [...]}
            names = next(iter(names.values()))
        if isinstance(names, list) and names and all(isinstance(name, str) and name for name in names):
            found[column] = names if len(set(names)) == len(names) else []
    everything = [name for names in found.values() for name in names]
    if len(set(everything)) < len(everything):
        return {column: [f"{column}.{name}" for name in names] for column, names in found.items()}
    return found


def _doubts(log: Log, info: Mapping[str, Any], frame: pl.DataFrame) -> list[dict[str, Any]]:
    """Findings on what the folder says of itself."""
    findings = []
    promised = info.get("total_frames")
    if isinstance(promised, int) and promised != frame.height:
        findings.append(
            {
                "finding": "frames-missing",
                "count": abs(promised - frame.height),
                "message": f"meta/info.json counts {promised:,} frames, the files hold {frame.height:,}; "
                "if the copy is incomplete, copy the missing files",
            }
        )
    if "terminated" in log.columns:
        last = (frame[EPISODE] != frame[EPISODE].shift(-1)).fill_null(True).to_numpy().astype(bool)
        if log.provenance["rows_in_file"] != len(log):
            return findings  # rows without values were left out; the flags of the others say nothing of every end
        ended = int(log.columns["terminated"][:][last].sum())
        if ended == int(last.sum()):
            findings.append(
                {
                    "finding": "done-at-every-end",
                    "count": ended,
                    "message": f"every episode ends with {log.provenance['columns']['terminated']}; if some of them "
                    'only ran out of time, learned values are wrong: name another column, such as "next.success", or '
                    "pass terminated=False",
                }
            )
    return findings
