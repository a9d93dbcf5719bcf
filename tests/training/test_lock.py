"""A run directory belongs to one process and its workers; whoever comes later is kept out until the last has gone."""

import pytest

from odaf.errors import ConfigError
from odaf.training.lock import joined, locked

pytest.importorskip("fcntl")


def test_workers_join_and_others_are_kept_out(tmp_path):
    with locked(tmp_path):
        with joined(tmp_path), joined(tmp_path), pytest.raises(ConfigError, match="another process"), locked(tmp_path):
            pass
        with pytest.raises(ConfigError, match="another process"), locked(tmp_path):
            pass


def test_worker_that_outlives_its_parent_keeps_others_out(tmp_path):
    with joined(tmp_path), pytest.raises(ConfigError, match="another process"), locked(tmp_path):
        pass
    with locked(tmp_path):
        pass


def test_worker_of_another_run_cannot_join_while_one_begins(tmp_path):
    import fcntl

    with (tmp_path / ".lock").open("w") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        with pytest.raises(ConfigError, match="another process"), joined(tmp_path):
            pass
