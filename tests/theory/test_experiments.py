"""The experiments in small: corrected statements hold, printed ones do not, and a broken operator is noticed."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from odaf.theory import operator
from odaf.theory.experiments import (
    EXPERIMENTS,
    Contraction,
    Coverage,
    Equivalence,
    ErrorBound,
    Experiment,
    Findings,
    Flexibility,
    ImpossibleRatio,
    LowerBound,
    ManySteps,
    RareAction,
    Trap,
)
from odaf.theory.experiments.experiment import Check, verdict

SMALL: tuple[Experiment, ...] = (
    Contraction(problems=3, pairs=10),
    ErrorBound(problems=2, draws=4, sizes=(10**3, 10**5), k=150),
    RareAction(draws=100),
    ImpossibleRatio(problems=1),
    ManySteps(problems=2, sequences=5),
    Equivalence(problems=100),
    Flexibility(problems=3),
    Trap(),
    LowerBound(problems=2, draws=4, sizes=(10**3, 10**5)),
    Coverage(problems=8),
)


def by_words(found: Findings) -> dict[str, Check]:
    return {check.what: check for check in found.checks}


@pytest.mark.parametrize("experiment", SMALL, ids=lambda each: each.name)
def test_what_can_be_proved_holds_and_what_is_printed_does_not(experiment: Experiment):
    found = experiment.measure()
    assert found.passed, [check for check in found.checks if check.verdict == "not held"]
    printed = [check.verdict for check in found.checks if check.of == "printed"]
    assert "held" not in printed
    assert bool(printed) == (experiment.name not in ("flexibility", "trap", "lower-bound"))
    again = experiment.measure()
    assert again == found  # equal settings give equal findings


def test_the_study_has_every_experiment_and_each_its_name():
    assert [type(each) for each in EXPERIMENTS] == [type(each) for each in SMALL]
    assert len({each.name for each in EXPERIMENTS}) == len(EXPERIMENTS)


def test_a_bound_that_is_never_near_says_nothing():
    assert verdict(True) == "held" and verdict(True, 0.5) == "held"
    assert verdict(True, 0.19) == "says nothing" and verdict(False, 0.0) == "not held"
    nothing = Check("corrected", "", 0.0, "", "says nothing")
    assert not Findings((nothing,), {}).passed  # passing nothing is not passing
    assert Findings((nothing, Check("corrected", "", 0.0, "", "held")), {}).passed
    assert Findings((Check("corrected", "", 0.0, "", "held"), Check("printed", "", 0.0, "", "not held")), {}).passed
    assert not Findings(
        (Check("corrected", "", 0.0, "", "held"), Check("corrected", "", 0.0, "", "not held")), {}
    ).passed


def test_the_bounds_of_small_logs_say_nothing_and_the_error_falls():
    found = by_words(SMALL[1].measure())
    bound = next(check for what, check in found.items() if what.startswith("share of logs that violate the bound"))
    assert bound.figure == 0.0 and bound.verdict == "says nothing"
    slope = found["slope of the logarithm of the mean error over that of N"]
    assert -0.65 <= slope.figure <= -0.35
    assert found["largest value over R_max"].figure > 2.0


def test_paths_on_the_grids():
    grid, trap = Flexibility(problems=1).measure().details, Trap().measure().details
    assert grid["start_values"]["action"] == pytest.approx(0.9**23)
    assert grid["start_values"]["outcome"] == pytest.approx(0.9**7)
    assert [len(trap["paths"][name]) - 1 for name in ("action", "outcome", "every action")] == [24, 8, 7]
    assert trap["paths"]["every action"][-1] == [2, 5] and trap["entries_of_every_action"] == 1
    assert [2, 5] not in trap["paths"]["outcome"] and [2, 4] in trap["paths"]["outcome"]  # it passes beside it
    assert trap["earned"] == pytest.approx({"action": 0.9**23, "outcome": 0.9**7, "every action": 0.0})
    assert trap["promised"]["every action"] == pytest.approx(0.9**6)


def with_another_discount(q: Any, mdp: Any, allowed: Any) -> Any:
    return mdp.rewards + 1.02 * (operator.backup(q, mdp, allowed) - mdp.rewards)


def with_a_smaller_discount(q: Any, mdp: Any, allowed: Any) -> Any:
    return mdp.rewards + 0.98 * (operator.backup(q, mdp, allowed) - mdp.rewards)


def over_every_action(transitions: Any, support: Any) -> Any:
    return np.ones(transitions.shape[:2], bool)


def the_first_action(transitions: Any, support: Any) -> Any:
    return np.arange(transitions.shape[1]) == np.zeros((transitions.shape[0], 1))


@pytest.mark.parametrize(
    ("experiment", "name", "broken"),
    [
        (SMALL[0], "backup", with_another_discount),
        (SMALL[0], "backup", with_a_smaller_discount),
        (SMALL[7], "outcome_supported", over_every_action),
        (SMALL[7], "action_supported", lambda logged, transitions, support: np.ones_like(logged)),
        (SMALL[9], "outcome_supported", the_first_action),
    ],
    ids=["larger-discount", "smaller-discount", "trap-by-every-action", "trap-by-unlogged-actions", "coverage"],
)
def test_a_broken_operator_or_set_is_noticed(
    experiment: Experiment, name: str, broken: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(f"{type(experiment).__module__}.{name}", broken)
    assert not experiment.measure().passed


def test_a_state_without_action_leaves_the_maximum_undefined(monkeypatch: pytest.MonkeyPatch):
    """As the paper defines the set, without the fallback."""
    monkeypatch.setattr(
        "odaf.theory.experiments.contraction.outcome_supported",
        lambda transitions, support: transitions[:, :, ~support].sum(-1) == 0.0,
    )
    with pytest.raises(RuntimeWarning, match="invalid value"):
        SMALL[0].measure()
