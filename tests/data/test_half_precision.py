"""Data sets in half precision: rounded first, then carried, the same data at both ends."""

import dataclasses

import numpy as np
import pytest

from odaf.cli import main
from odaf.data import fingerprint, half_precision, storage
from odaf.data.dataset import Dataset
from odaf.errors import DatasetError


def _log(offset: float = 0.0, scale: float = 1.0) -> Dataset:
    rng = np.random.default_rng(0)
    observations = offset + scale * rng.normal(size=(40, 3))
    actions = np.clip(rng.normal(size=(40, 2)), -0.3, 0.3)
    last = np.arange(40) % 10 == 9
    never = np.zeros(40, bool)
    return Dataset.from_arrays(
        observations, actions, rng.normal(size=40), terminated=last, truncated=never, action_bounds=(-0.3, 0.3)
    )


def test_what_is_carried_is_what_was_rounded_to_the_last_bit(tmp_path):
    log, whole, half = _log(), tmp_path / "whole.h5", tmp_path / "half.h5"
    log.save(whole)
    assert main(["data", "convert", str(whole), "--to", "odaf", "--precision", "half", "--out", str(half)]) == 0
    found = Dataset.load(half)
    np.testing.assert_array_equal(found.observations, log.observations.astype(np.float16).astype(np.float32))
    np.testing.assert_array_equal(found.observations.astype(np.float16).astype(np.float32), found.observations)
    assert found.observations.dtype == np.float32 and found.provenance["precision"] == "half"
    assert found.provenance["rounded_from"] == fingerprint.record(log)
    assert found.fingerprint() != log.fingerprint()
    again = tmp_path / "again.h5"  # from the file, in single precision: the same data
    found.save(again)
    assert fingerprint.record(Dataset.load(again)) == fingerprint.record(found)
    with storage.opened(half) as (file, _):
        assert file.attrs["version"] == 3 and storage.read_array(file, "half", "observations").dtype == np.float16
    assert storage.open_log(half).columns["observations"][:].dtype == np.float32


def test_rounded_actions_stay_inside_their_bounds():
    """0.3 is 0.30005 in half precision."""
    found = half_precision.rounded(_log())
    assert np.float32(np.float16(0.3)) > np.float32(0.3)
    assert (found.actions <= found.action_high).all() and (found.actions >= found.action_low).all()
    np.testing.assert_allclose(found.actions, _log().actions, atol=5e-4)


def test_what_half_precision_would_spoil_is_refused():
    with pytest.raises(DatasetError, match="observations hold numbers beyond 65,504"):
        half_precision.rounded(_log(scale=1e5))
    with pytest.raises(DatasetError, match="column 0 of observations varies by 1.11 .* subtract an offset"):
        half_precision.rounded(_log(offset=3000.0))
    fine = half_precision.rounded(dataclasses.replace(_log(), infos={"time": np.arange(40.0)}))
    assert not fine.infos


def test_other_layouts_hold_single_precision(tmp_path, capsys):
    _log().save(tmp_path / "log.h5")
    words = ["data", "convert", str(tmp_path / "log.h5"), "--precision", "half", "--to", "d4rl"]
    assert main([*words, "--out", str(tmp_path / "out.h5")]) == 2
    assert "take --to odaf" in capsys.readouterr().err
