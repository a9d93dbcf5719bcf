"""The scores that the paper prints for the public sets; never mixed with scores of our own.

Source: Beyond Non-Expert Demonstrations, Table 1; part of the rivals' columns it takes from other papers.
"""

import json
from functools import cache
from importlib import resources

COLUMNS = {
    "odaf-paper": "ODAF",
    "cql": "CQL",
    "pbrl": "PBRL",
    "spot": "SPOT",
    "svr": "SVR",
    "edac-num_critics-10": "EDAC",
    "rorl": "RORL",
    "sdc": "SDC",
    "osr-10": "OSR-10",
}
"""By our method the paper's column."""


def paper_score(set_name: str, column: str) -> float | None:
    """What the paper prints for a method on a public set; None where it prints nothing.

    Args:
        set_name: as in `hopper-medium`.
        column: as in `OSR-10`.
    """
    found = _table().get(set_name, {}).get(column)
    return float(found[0]) if isinstance(found, list) else found


@cache
def _table() -> dict[str, dict[str, float | list[float]]]:
    text = resources.files("odaf.studies").joinpath("paper_scores.json").read_text(encoding="utf-8")
    return json.loads(text)["comparison_mujoco_d4rl"]
