"""The report as people and programs get it."""

import json

import numpy as np
import pytest

from data.checks import healthy
from odaf.data.checks import Finding, Report, check_log
from odaf.errors import DatasetError


def report(*severities: str) -> Report:
    findings = tuple(
        Finding(f"check-{index}", severity, "rewards", 3, (1, 2), "looks odd", "mend it")  # type: ignore[arg-type]
        for index, severity in enumerate(severities)
    )
    return Report("tank.csv", "csv", findings, {"transitions": 12, "episodes": 1})


@pytest.mark.parametrize(
    ("severities", "plain", "strict"),
    [((), 0, 0), (("note",), 0, 0), (("warning", "note"), 0, 1), (("error", "warning"), 2, 2)],
)
def test_exit_codes(severities: tuple[str, ...], plain: int, strict: int):
    assert report(*severities).exit_code() == plain
    assert report(*severities).exit_code(strict=True) == strict


def test_printed():
    text = str(report("error", "warning"))
    assert text.splitlines()[0] == "tank.csv · csv · 12 rows, 1 episode"
    assert "not usable as it is: 1 error, 1 warning" in text
    assert "looks odd (rows 1, 2, ...)." in text
    assert "-> mend it" in text
    assert max(map(len, text.splitlines())) <= 110


def test_a_healthy_log_is_said_to_be_usable():
    assert "usable; nothing to complain about" in str(check_log(healthy.log()))


def test_json():
    spoiled = healthy.columns()["rewards"]
    spoiled[4] = np.nan
    content = json.loads(json.dumps(check_log(healthy.log({"rewards": spoiled})).to_dict(), allow_nan=False))
    assert content["usable"] is False
    assert content["counts"] == {"error": 1, "warning": 0, "note": 0}
    (finding,) = content["findings"]
    assert (finding["check"], finding["rows"], finding["count"]) == ("not-finite", [4], 1)
    assert content["figures"]["episodes"] == healthy.EPISODES


def test_figures_are_those_of_numpy():
    columns = healthy.columns()
    figures = check_log(healthy.log()).figures
    for name in ("observations", "actions"):
        np.testing.assert_allclose(figures[name]["mean"], columns[name].mean(axis=0), rtol=1e-9)
        np.testing.assert_allclose(figures[name]["std"], columns[name].std(axis=0), rtol=1e-9)
        np.testing.assert_allclose(figures[name]["high"], columns[name].max(axis=0))
    returns = [columns["rewards"][columns["episode"] == index].sum() for index in range(healthy.EPISODES)]
    lengths = [(columns["episode"] == index).sum() for index in range(healthy.EPISODES)]
    assert figures["mean_return"] == pytest.approx(np.mean(returns))
    assert figures["lowest_return"] == pytest.approx(min(returns))
    assert figures["std_length"] == pytest.approx(np.std(lengths))


def test_spread_of_large_numbers_close_together():
    """Squares of a million with a spread of one would cancel in a careless sum."""
    columns = healthy.columns()
    shifted = columns["observations"] + 1e7
    figures = check_log(healthy.log({"observations": shifted}, ("next_observations",))).figures
    np.testing.assert_allclose(figures["observations"]["std"], columns["observations"].std(axis=0), rtol=1e-6)


def test_errors_raise_unless_they_are_accepted():
    found = report("error", "error", "warning")
    with pytest.raises(DatasetError, match="tank.csv: field 'rewards': looks odd .rows 1, 2, ....; mend it") as raised:
        found.require_usable()
    assert len(str(raised.value).splitlines()) == 2
    with pytest.raises(DatasetError):
        found.require_usable(accept=["check-0"])
    found.require_usable(accept=["check-0", "check-1"])
