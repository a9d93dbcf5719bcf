"""From raw columns to the fields of a `Dataset`: what is completed on the way in, what its constructor insists on."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from odaf.data import episodes, validation
from odaf.data.arrays import identifiers
from odaf.data.rows import Rows
from odaf.errors import DatasetError

_INFO = "infos/"


def completed(
    source: str,
    columns: Mapping[str, Any],
    *,
    episode: Any,
    action_bounds: validation.Bounds | None,
    observation_names: Sequence[str] | None,
    action_names: Sequence[str] | None,
    infos: Mapping[str, Any],
    provenance: Mapping[str, Any],
    row_numbers: validation.RowNumbers | None,
) -> dict[str, Any]:
    """Arguments of `Dataset` from raw columns: ends and successors filled in, rounding clipped, all of it counted.

    Args:
        source: how messages name the rows.
        columns: by field of `Dataset`, as `Dataset.from_arrays` takes them; None where not given.
        episode: as `Dataset.from_arrays` takes it, like the other arguments.

    Raises:
        DatasetError: as `Dataset.from_arrays`.
    """
    own = {
        "observations": validation.matrix(source, "observations", columns["observations"], row_numbers),
        "actions": validation.matrix(source, "actions", columns["actions"], row_numbers),
        "rewards": validation.vector(source, "rewards", columns["rewards"], row_numbers),
    }
    if columns["next_observations"] is not None:
        own["next_observations"] = validation.matrix(
            source, "next_observations", columns["next_observations"], row_numbers
        )
    for name in ("terminated", "truncated"):
        if columns[name] is not None:
            own[name] = validation.flags(source, name, columns[name], row_numbers)
    rows = validation.same_length(source, own)
    if row_numbers is not None and len(row_numbers) != rows:
        raise DatasetError(
            f"{source}: row_numbers names {len(row_numbers):,} rows, there are {rows:,}; number each once"
        )
    extra = validation.infos(source, infos, rows, row_numbers)
    if "next_observations" in own:
        validation.same_width(source, own["observations"], own["next_observations"])
    if episode is not None:
        episode = identifiers(source, "episode", episode, row_numbers)
        if episode.shape != (rows,):
            raise DatasetError(
                f"{source}: field 'episode' must be [rows], one id per step; "
                f"got shape {episode.shape} for {rows:,} rows"
            )
    action_names = validation.names(source, "action_names", action_names, own["actions"].shape[1], "action")
    findings: list[dict[str, Any]] = []
    low, high = _bounded_actions(source, own, action_names, action_bounds, findings, row_numbers)
    own |= {f"{_INFO}{name}": values for name, values in extra.items()}  # so that they lose the same rows
    starts = episodes.complete(source, own, episode, findings, row_numbers)
    extra = {name: own.pop(f"{_INFO}{name}") for name in extra}
    for column in own.values():
        column.setflags(write=False)  # so that the constructor need not copy it
    return {
        **own,
        "episode_starts": starts,
        "action_low": low,
        "action_high": high,
        "observation_names": validation.names(
            source, "observation_names", observation_names, own["observations"].shape[1], "observation"
        ),
        "action_names": action_names,
        "infos": extra,
        "provenance": {**provenance, "findings": [*provenance.get("findings", []), *findings]},
    }


def _bounded_actions(
    source: str,
    columns: dict[str, np.ndarray],
    names: tuple[str, ...],
    bounds: validation.Bounds | None,
    findings: list[dict[str, Any]],
    row_numbers: validation.RowNumbers | None,
) -> np.ndarray:
    """[2, act_dim] lowest and highest action; actions that miss them by rounding are moved onto them."""
    low, high = pair = validation.action_bounds(source, columns["actions"], names, bounds)
    if bounds is None:
        findings.append(
            {
                "finding": "action-bounds-from-data",
                "count": len(names),
                "message": "no action_bounds were given; the smallest and largest logged action stand in for them",
            }
        )
    strays = validation.outside_bounds(source, columns["actions"], low, high, row_numbers)
    if strays.any():
        rows = validation.name_rows(strays, row_numbers)
        columns["actions"] = np.clip(columns["actions"], low, high)
        findings.append(
            {
                "finding": "actions-clipped",
                "count": int(strays.sum()),
                "message": f"actions moved onto the bounds they miss by rounding, {rows}",
            }
        )
    return pair


def checked(dataset: Rows, source: str) -> dict[str, Any]:
    """The fields of a dataset that is being constructed, in their final types; nothing is completed here.

    Raises:
        DatasetError: a field has the wrong type, shape or length, or two fields contradict each other.
    """
    own: dict[str, Any] = {}
    for name in ("observations", "actions", "next_observations"):
        own[name] = validation.matrix(source, name, getattr(dataset, name))
    own["rewards"] = validation.vector(source, "rewards", dataset.rewards)
    for name in ("terminated", "truncated"):
        own[name] = validation.flags(source, name, getattr(dataset, name))
    rows = validation.same_length(source, own)
    validation.same_width(source, own["observations"], own["next_observations"])
    obs_dim, act_dim = own["observations"].shape[1], own["actions"].shape[1]
    own["observation_names"] = validation.names(
        source, "observation_names", dataset.observation_names, obs_dim, "observation"
    )
    own["action_names"] = validation.names(source, "action_names", dataset.action_names, act_dim, "action")
    own["observation_units"] = validation.units(source, "observation_units", dataset.observation_units, obs_dim)
    own["action_units"] = validation.units(source, "action_units", dataset.action_units, act_dim)
    own["infos"] = validation.infos(source, dataset.infos, rows)
    bounds = validation.action_bounds(
        source, own["actions"], own["action_names"], (dataset.action_low, dataset.action_high)
    )
    own["action_low"], own["action_high"] = bounds[0].copy(), bounds[1].copy()
    strays = validation.outside_bounds(source, own["actions"], bounds[0], bounds[1])
    if strays.any():
        raise DatasetError(
            f"{source}: field 'actions' leaves its bounds in {validation.name_rows(strays)}; "
            "build the dataset with Dataset.from_arrays, which clips rounding errors and records it"
        )
    own["episode_starts"] = episodes.check_starts(source, dataset.episode_starts, rows)
    episodes.check_ends(source, own["episode_starts"], own["terminated"], own["truncated"])
    if dataset.mixture is not None:
        dataset.mixture.check(source, own["episode_starts"])
    own["provenance"] = validation.plain_json(source, dataset.provenance)
    return own
