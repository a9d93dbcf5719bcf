"""Public files as the logs of a study: read, mixed, told by their bytes, and refused where they are not there."""

from pathlib import Path

import pytest

from odaf.cli.dispatch import main
from odaf.data.convert import to_d4rl
from odaf.data.dataset import Dataset
from odaf.environments.locomotion_data import generate
from odaf.errors import ConfigError
from odaf.studies.public_logs import PublicLog, PublicMixture
from odaf.studies.registry import STUDIES

pytest.importorskip("mujoco")


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("d4rl")
    for kind, name in (("random", "hopper_random-v2.hdf5"), ("expert", "hopper-expert-v2.hdf5")):
        to_d4rl(generate(f"hopper-{kind}", 200, seed=0).with_provenance(environment=None), folder / name)
    return folder


def test_a_public_file_is_a_log_with_its_environment(files: Path, tmp_path: Path) -> None:
    log = PublicLog(files, "hopper-random")
    dataset = Dataset.load(log.present(tmp_path))
    assert dataset.environment == {"name": "gymnasium", "id": "Hopper-v4"} and len(dataset) > 190
    assert log.recipe()["file"] == "hopper_random-v2.hdf5" and len(log.recipe()["sha256"]) == 64
    assert log.recipe()["sha256"] != PublicLog(files, "hopper-expert").recipe()["sha256"]
    with pytest.raises(ConfigError, match=r"has no file walker2d_medium_replay-v2.hdf5 or .*; put it there"):
        PublicLog(files, "walker2d-medium-replay").recipe()


def test_public_files_are_mixed_as_those_made_here_are(files: Path, tmp_path: Path) -> None:
    mixture = PublicMixture(files, "hopper", 75, transitions=120)
    dataset = Dataset.load(mixture.present(tmp_path))
    assert mixture.name == "hopper-mixture-75" and len(dataset) == 120
    parts = [Dataset.load(part.source).rewards for part in mixture.parts]
    assert (dataset.rewards[:30] == parts[0][:30]).all() and (dataset.rewards[30:] == parts[1][:90]).all()
    assert mixture.recipe()["expert"]["file"] == "hopper-expert-v2.hdf5"


def test_a_study_on_files_plans_with_them_and_keeps_a_ledger_of_its_own(
    files: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    on_files = STUDIES["mixtures"].on_files
    assert on_files is not None
    logs = {job.do.log for job in on_files(files).jobs()}
    assert all(isinstance(log, PublicMixture) for log in logs) and len(logs) == 15
    monkeypatch.chdir(tmp_path)
    assert main(["reproduce", "theory", "--data", str(files)]) == 2
    assert "theory records its logs itself; studies that take public files are validation" in capsys.readouterr().err
    assert main(["reproduce", "mujoco", "--data", "nowhere"]) == 2
    assert "nowhere: there is no such directory" in capsys.readouterr().err
