"""What the studies share: choosing a part of a plan, and runs whose parameters were lost."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from odaf.errors import ConfigError, DivergenceError
from odaf.evaluation.rollouts import Rollouts
from odaf.runs import fit as fitting
from odaf.studies import ledger
from odaf.studies.ledger import StudyRun, chosen_phases

PLAIN = StudyRun("odaf", "stitch", 0, 10)
CHANGED = StudyRun("odaf", "stitch", 0, 10, (("return_steps", 3),))
CLONING = StudyRun("behaviour-cloning", "stitch", 0, 10)
PLAN = [[PLAIN, CLONING], [CHANGED]]


def test_a_part_of_a_plan() -> None:
    assert CHANGED.name == "stitch-odaf-return_steps-3-seed0-10"
    assert chosen_phases(PLAN) == PLAN
    assert chosen_phases(PLAN, phase=[2]) == [[CHANGED]]
    assert chosen_phases(PLAN, only=["odaf"]) == [[PLAIN], [CHANGED]]  # a preset with its variants
    assert chosen_phases(PLAN, only=["odaf-return_steps-3"]) == [[], [CHANGED]]


def test_what_is_not_in_the_plan_is_refused() -> None:
    with pytest.raises(ConfigError, match="--phase 3: this study has phases 1 to 2"):
        chosen_phases(PLAN, phase=[3])
    with pytest.raises(ConfigError, match="--only oddaf: .* known are behaviour-cloning, odaf, odaf-return_steps-3"):
        chosen_phases(PLAN, only=["oddaf"])


def test_a_lost_run_is_recorded_without_the_score_of_an_earlier_checkpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    summary: dict[str, Any] = {"step": 7, "status": "diverged", "evaluation": {"mean_return": 5.0}}
    summary |= dict.fromkeys(("updates_per_second", "seconds", "pretrain", "warnings"))
    files = SimpleNamespace(
        summary={0: summary},
        directory=tmp_path,
        data={"sha256": "ab"},
        config={"algorithm": {}},
        metrics=lambda seed: [],
    )

    def diverge(*arguments: Any) -> None:
        raise DivergenceError("lost")

    monkeypatch.setattr(ledger, "train", diverge)
    monkeypatch.setattr(fitting, "load_run", lambda directory: files)
    (tmp_path / "environment.json").write_text('{"python": "", "versions": {}, "device": "", "platform": ""}')
    with pytest.raises(DivergenceError):  # lost in pretraining: there is no run to record
        ledger.train_while_finite(PLAIN, tmp_path, None, tmp_path, Rollouts())
    (tmp_path / PLAIN.title).mkdir()
    (tmp_path / PLAIN.title / "config.json").write_text("{}")
    facts = ledger.run_facts(PLAIN, ledger.train_while_finite(PLAIN, tmp_path, None, tmp_path, Rollouts()))
    assert (facts["status"], facts["updates"], facts["final"]) == ("diverged", 7, None)
