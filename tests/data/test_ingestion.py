"""A log becomes a data set that carries its report; one with errors does not."""

import numpy as np
import pytest

from data.checks import healthy
from odaf.data import Dataset
from odaf.data.ingestion import ingest
from odaf.errors import DatasetError


def test_the_report_is_stored_with_the_data(tmp_path):
    constant = healthy.columns()["observations"]
    constant[:, 1] = 4.0
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


def test_what_cannot_be_held_is_refused_even_if_accepted():
    missing = healthy.columns()["rewards"]
    missing[3] = np.nan
    with pytest.raises(DatasetError, match="NaN or infinity"):
        ingest(healthy.log({"rewards": missing}), accept=["not-finite"])
