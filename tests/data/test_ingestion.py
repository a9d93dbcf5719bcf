"""A log becomes a data set that carries its report; one with errors does not."""

import numpy as np
import pytest

from data.checks import healthy
from data.checks.test_every_check import SPOILED, spoiled
from odaf.data import Dataset
from odaf.data.checks import check_log
from odaf.data.ingestion import NEVER_HELD, ingest
from odaf.errors import ConfigError, DatasetError


def test_the_report_is_stored_with_the_data(tmp_path):
    constant = healthy.columns()["observations"]
    constant[:, 2] = 4.0  # the one that no action moves
    dataset, report = ingest(healthy.log({"observations": constant}, ("next_observations",)))
    assert [finding.check for finding in report.findings] == ["constant-dimension", "no-successor"]
    dataset.save(tmp_path / "tank.h5")
    validation = Dataset.load(tmp_path / "tank.h5").provenance["validation"]
    assert validation["verdict"] == "usable, with 1 warning"
    assert validation["findings"] == report.to_dict()["findings"]
    # Twenty episodes were cut, and nobody logged what followed their last rows.
    assert report.findings[1].count == 20
    assert len(dataset) == len(constant) - 20


def test_errors_are_refused_unless_accepted():
    choices = healthy.log({"actions": np.eye(3)[np.arange(len(healthy.columns()["rewards"])) % 3]})
    with pytest.raises(DatasetError, match="one-hot choices"):
        ingest(choices)
    dataset, _ = ingest(choices, accept=["actions-discrete"])
    assert dataset.provenance["validation"]["accepted"] == ["actions-discrete"]


def test_what_cannot_be_held_cannot_be_accepted():
    missing = healthy.columns()["rewards"]
    missing[3] = np.nan
    with pytest.raises(ConfigError, match='accept: not-finite: no data set can hold such rows.*on_missing="break"'):
        ingest(healthy.log({"rewards": missing}), accept=["actions-discrete", "not-finite"])


@pytest.mark.parametrize("name", SPOILED)
def test_errors_that_may_be_accepted_are_those_that_a_data_set_can_hold(name: str):
    log = spoiled(name)
    errors = {finding.check for finding in check_log(log).of("error")}
    if errors and not errors & set(NEVER_HELD):
        assert isinstance(ingest(log, accept=sorted(errors))[0], Dataset)
    for check in errors & set(NEVER_HELD):
        with pytest.raises((DatasetError, TypeError)):
            Dataset.from_log(log)
        with pytest.raises(ConfigError, match=check):
            ingest(log, accept=[check])
