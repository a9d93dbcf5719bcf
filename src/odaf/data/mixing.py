"""Two data sets as one: expert rows diluted with rows of a poorer controller, as published studies build them.

`mix` keeps as many rows of each as the ratio asks for. `mix_per_batch` keeps all rows, and the ratio holds in each
batch that is drawn in training. On average a batch is composed alike, but the first leaves few expert rows at high
ratios, the second all of them: an easier task, and scores on the two must not be compared.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from odaf.data.dataset import Dataset
from odaf.data.mixture import Mixture
from odaf.data.rows import COLUMNS
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
    Mixture(len(expert), ratio)  # refuses a ratio that is none
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
    return _joined(parts[0], parts[1], {"construction": "static", "ratio": ratio}, (expert, other))


def mix_per_batch(expert: Dataset, other: Dataset, ratio: float) -> Dataset:
    """All rows of `expert`, then all rows of `other`; training takes each row of a batch from the latter with `ratio`.

    The ratio and the border are the result's `mixture`: stored with it, part of its fingerprint, and heeded by
    `odaf.fit`. What looks at the rows as they are, such as statistics, checks and the training of dynamics models, sees
    all of them once.

    Args:
        expert: the better data.
        other: the poorer data, of the same task.
        ratio: share of rows from `other` in a batch, strictly between 0 and 1.

    Raises:
        DatasetError: the two describe different quantities, or one of them is such a mixture itself.

    Source:
        The released code of OSR draws a batch of each part and exchanges row by row with probability `ratio`.
    """
    mixture = Mixture(len(expert), ratio)
    _require_same_task(expert, other)
    joined = _joined(expert, other, {"construction": "per-batch", "ratio": ratio}, (expert, other))
    return replace(joined, mixture=mixture, source="mix")


def _joined(first: Dataset, second: Dataset, construction: dict[str, Any], whole: tuple[Dataset, Dataset]) -> Dataset:
    """The rows of one after those of the other; `whole` are the data sets that they were taken from."""
    parts = (first, second)
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in (*COLUMNS, "episode_starts")
    }
    columns["episode_starts"][first.num_episodes :] += len(first)
    infos = [
        name
        for name, values in first.infos.items()
        if name in second.infos and _can_be_joined(values, second.infos[name])
    ]
    columns["infos"] = {name: np.concatenate([part.infos[name] for part in parts]) for name in infos}
    dropped = sorted({*first.infos, *second.infos} - set(infos))
    return Dataset(
        **columns,
        **{name: getattr(first, name) for name in COMMON},
        action_low=first.action_low,
        action_high=first.action_high,
        provenance=_provenance(whole, construction, [len(part) for part in parts], dropped),
        source="mix",
    )


def _can_be_joined(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two further columns have one shape, and a common type that holds the numbers of both exactly."""
    common = np.result_type(one, other)
    whole = [column.dtype.itemsize for column in (one, other) if column.dtype.kind in "iu"]
    exact = common.kind != "f" or not whole or max(whole) < common.itemsize
    return one.shape[1:] == other.shape[1:] and exact


def first_rows(dataset: Dataset, count: int) -> Dataset:
    """The first `count` rows; an episode that is cut there counts as truncated and keeps its logged successor."""
    if not 1 <= count <= len(dataset):
        raise DatasetError(f"first_rows: {count:,} rows are wanted of {len(dataset):,}; ask for fewer, at least one")
    _refuse_mixture("first_rows", dataset)
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


def _refuse_mixture(source: str, dataset: Dataset) -> None:
    if dataset.mixture is not None:
        raise DatasetError(
            f"{source}: the data are a mixture themselves, whose batches are drawn from two parts; give those parts"
        )


def _require_same_task(expert: Dataset, other: Dataset) -> None:
    for part in (expert, other):
        _refuse_mixture("mix", part)
    for what, left, right in (
        ("numbers in an observation", expert.obs_dim, other.obs_dim),
        ("numbers in an action", expert.act_dim, other.act_dim),
        *((name.replace("_", " "), getattr(expert, name), getattr(other, name)) for name in COMMON),
        ("lowest action", expert.action_low.tolist(), other.action_low.tolist()),
        ("highest action", expert.action_high.tolist(), other.action_high.tolist()),
        ("what observations are made of", expert.provenance.get("derived", []), other.provenance.get("derived", [])),
    ):
        if left != right:
            raise DatasetError(
                f"mix: the two differ in {what}: {left} and {right}; only data of one task can be mixed, "
                "read with the same names, units and action bounds"
            )


def _provenance(
    parts: tuple[Dataset, Dataset], construction: dict[str, Any], counts: list[int], dropped: list[str]
) -> dict[str, Any]:
    findings = []
    if dropped:
        findings.append(
            {
                "finding": "infos-dropped",
                "count": len(dropped),
                "message": "further columns that the two do not both have, in types that go together, were left out: "
                + ", ".join(dropped),
            }
        )
    provenance: dict[str, Any] = {
        "mixture": {
            **construction,
            "parts": [
                {"role": role, "rows": count, "sha256": part.file_fingerprint(), "provenance": part.provenance}
                for role, part, count in zip(("expert", "other"), parts, counts, strict=True)
            ],
        },
        "findings": findings,
    }
    expert, other = parts
    if expert.environment is not None and expert.environment == other.environment:
        provenance["environment"] = expert.environment
    if "derived" in expert.provenance:
        provenance["derived"] = expert.provenance["derived"]
    return provenance
