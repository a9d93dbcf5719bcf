"""Two data sets as one: expert rows diluted with rows of a poorer controller, as published studies build them."""

import math
from typing import Any

import numpy as np

from odaf.data.dataset import COLUMNS, Dataset
from odaf.errors import DatasetError

COMMON = ("observation_names", "action_names", "observation_units", "action_units")


def mix(expert: Dataset, other: Dataset, ratio: float, transitions: int | None = None) -> Dataset:
    """The first rows of `expert`, then the first rows of `other`, a share `ratio` of all from the latter.

    The static construction: rows are neither drawn nor shuffled, so at ratio 0.9 of a million rows the expert's part is
    the first 100,000 of its file. Where a part stops inside an episode, its last row counts as truncated and keeps the
    successor that was logged; no row claims a successor from the other part.

    Args:
        expert: the better data.
        other: the poorer data, of the same task.
        ratio: share of rows from `other`, strictly between 0 and 1.
        transitions: rows of the result; None takes as many as `other` has. Each part is rounded down.

    Raises:
        DatasetError: the two describe different quantities, or one of them has too few rows.

    Source:
        The authors' released data preparation for ODAF. There the end flags of the poorer part are not cut to its
        length; here every column is.
    """
    if not 0.0 < ratio < 1.0:
        raise DatasetError(f"mix: ratio is {ratio}; give the share of the poorer rows, between 0 and 1, such as 0.7")
    _require_same_task(expert, other)
    total = len(other) if transitions is None else transitions
    # A hair is added because 1 - 0.9 is a hair less than 0.1.
    counts = [math.floor(share * total + 1e-6) for share in (1.0 - ratio, ratio)]
    for name, part, count in (("expert", expert, counts[0]), ("other", other, counts[1])):
        if not 1 <= count <= len(part):
            raise DatasetError(
                f"mix: {count:,} rows are wanted of the {name} data, which have {len(part):,}; "
                f"change the ratio, or ask for other than {total:,} transitions"
            )
    parts = [first_rows(part, count) for part, count in zip((expert, other), counts, strict=True)]
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in (*COLUMNS, "episode_starts")
    }
    columns["episode_starts"][parts[0].num_episodes :] += counts[0]
    infos = [
        name
        for name, values in parts[0].infos.items()
        if name in parts[1].infos and parts[1].infos[name].shape[1:] == values.shape[1:]
    ]
    columns["infos"] = {name: np.concatenate([part.infos[name] for part in parts]) for name in infos}
    dropped = sorted({*parts[0].infos, *parts[1].infos} - set(infos))
    return Dataset(
        **columns,
        **{name: getattr(expert, name) for name in COMMON},
        action_low=expert.action_low,
        action_high=expert.action_high,
        provenance=_provenance(expert, other, ratio, counts, dropped),
        source="mix",
    )


def first_rows(dataset: Dataset, count: int) -> Dataset:
    """The first `count` rows; an episode that is cut there counts as truncated and keeps its logged successor."""
    if not 1 <= count <= len(dataset):
        raise DatasetError(f"first_rows: {count:,} rows are wanted of {len(dataset):,}; ask for fewer, at least one")
    columns: dict[str, Any] = {name: getattr(dataset, name)[:count] for name in COLUMNS}
    if not columns["terminated"][-1]:
        columns["truncated"] = columns["truncated"].copy()
        columns["truncated"][-1] = True
    return Dataset(
        **columns,
        **{name: getattr(dataset, name) for name in COMMON},
        episode_starts=dataset.episode_starts[dataset.episode_starts < count],
        action_low=dataset.action_low,
        action_high=dataset.action_high,
        infos={name: values[:count] for name, values in dataset.infos.items()},
        provenance=dataset.provenance,
        source="first_rows",
    )


def _require_same_task(expert: Dataset, other: Dataset) -> None:
    for what, left, right in (
        ("numbers in an observation", expert.obs_dim, other.obs_dim),
        ("numbers in an action", expert.act_dim, other.act_dim),
        *((name.replace("_", " "), getattr(expert, name), getattr(other, name)) for name in COMMON),
        ("lowest action", expert.action_low.tolist(), other.action_low.tolist()),
        ("highest action", expert.action_high.tolist(), other.action_high.tolist()),
    ):
        if left != right:
            raise DatasetError(
                f"mix: the two differ in {what}: {left} and {right}; only data of one task can be mixed, "
                "read with the same names, units and action bounds"
            )


def _provenance(expert: Dataset, other: Dataset, ratio: float, counts: list[int], dropped: list[str]) -> dict[str, Any]:
    findings = []
    if dropped:
        findings.append(
            {
                "finding": "infos-dropped",
                "count": len(dropped),
                "message": f"further columns that only one of the two has were left out: {', '.join(dropped)}",
            }
        )
    provenance: dict[str, Any] = {
        "mixture": {
            "construction": "static",
            "ratio": ratio,
            "parts": [
                {"role": role, "rows": count, "sha256": part.fingerprint(), "provenance": part.provenance}
                for role, part, count in zip(("expert", "other"), (expert, other), counts, strict=True)
            ],
        },
        "findings": findings,
    }
    if expert.environment is not None and expert.environment == other.environment:
        provenance["environment"] = expert.environment
    return provenance
