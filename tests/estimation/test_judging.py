"""When an interval is a verdict, and when states unlike the log's take it back."""

import dataclasses

import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from estimation.grounds import HORIZON, SMALL, constant, gliding
from odaf.components.behaviour_models import init_gaussian
from odaf.estimation.density import BehaviourDensity
from odaf.estimation.evidence import Evidence
from odaf.estimation.judging import judged
from odaf.estimation.of_policy import ByMembers, Judged, OfPolicy
from odaf.estimation.outcomes import Unknown
from odaf.estimation.shrinkage import shrink
from odaf.estimation.valuation import Interval

ONE = Interval(1.0, 0.0, 2.0)


@pytest.mark.parametrize(
    ("low", "high", "share", "below", "above", "verdict"),
    [
        (1.0, 3.0, 0.0, 0.0, 0.0, "better"),
        (1.0, 3.0, 0.9, 0.9, 50.0, "better"),  # even at worst it lies above
        (1.0, 3.0, 0.1, 1.1, 0.0, "refused"),
        (-3.0, -1.0, 0.9, 50.0, 0.9, "worse"),
        (-3.0, -1.0, 0.1, 0.0, 1.1, "refused"),
        (-1.0, 1.0, 0.5, 9.0, 9.0, "not decided"),
        (-1.0, 1.0, 0.6, 9.0, 9.0, "refused"),
    ],
)
def test_a_verdict_stands_whatever_unlike_states_earn_or_not_at_all(low, high, share, below, above, verdict):
    unknown = Unknown(share, below, above, -1.0, 1.0)
    found = judged(
        "model", ONE, ONE, Interval(0.5 * (low + high), low, high), [], unknown=unknown, figures={}, better=0
    )
    assert found.verdict == verdict
    assert bool(found.reason) == (verdict == "refused")
    if verdict == "refused":
        assert f"{share:.0%} of the states" in found.reason
    assert found.figures == {"unknown_below": below, "unknown_above": above}


def test_reasons_refuse_whatever_the_interval_says():
    found = judged("fqe", ONE, ONE, Interval(2.0, 1.0, 3.0), ["it is not so"], figures={}, better=0.9)
    assert (found.verdict, found.reason) == ("refused", "it is not so")


def of_policy(off: float, unlike: float = 0.0) -> OfPolicy:
    """The model puts a policy 2 above the behaviour, fitted Q 2 below and misses the behaviour's value by so much."""
    dataset = gliding(30, ends=False)
    log = Evidence(dataset, HORIZON, (1.0,), dataclasses.replace(SMALL, members=4), jr.key(0))
    own = log.own[0][0][0]
    actions = np.zeros((len(dataset), 1, 1), np.float32)

    def members(control: float, above: float) -> ByMembers:
        scatter = np.array([0.0, 0.01, -0.01, 0.02, -0.02])
        lengths = np.full(5, float(HORIZON))
        behaviour = np.stack([np.full(5, own + control) + 0.5 * scatter, lengths])[None]
        return ByMembers(behaviour + np.stack([above + scatter, np.zeros(5)])[None], behaviour, {})

    density = BehaviourDensity(init_gaussian(jr.key(0), 1, 1, (4,)), jnp.asarray(log.observations))
    unknown = [Unknown(0.0, 0.0, 0.0, -1.0, 1.0)]
    known = Judged(constant(dataset), actions, actions, "is deterministic", unlike)
    made = OfPolicy(log, "mode", known, None, members(0.0, 2.0), unknown, density, None)
    made.by_members["fqe"] = members(off, -2.0)
    return made


def test_an_estimator_that_misses_the_known_value_by_much_is_left_out_of_the_blend():
    (found,) = of_policy(off=50.0).valuations(("fqe", "model", "blend"))
    assert [each.verdict for each in found.estimates] == ["refused", "better", "better"]
    assert "it does not hold for this log" in found["fqe"].reason
    assert found["blend"].difference == found["model"].difference
    assert found["blend"].figures["weight_model"] == 1.0 and "weight_fqe" not in found["blend"].figures


def test_estimators_that_are_as_good_and_disagree_decide_nothing():
    (found,) = of_policy(off=0.0).valuations(("fqe", "model", "blend"))
    assert [each.verdict for each in found.estimates] == ["worse", "better", "not decided"]
    assert found["blend"].difference is not None and found["blend"].difference.value == pytest.approx(0.0, abs=1e-9)


def test_fitted_q_is_drawn_toward_the_log_and_refused_for_the_same_reasons():
    (found,) = of_policy(off=0.0, unlike=0.4).valuations(("fqe", "shrunk"))
    fqe, shrunk, own = found["fqe"], found["shrunk"], found.behaviour
    assert fqe.difference and shrunk.difference and shrunk.value and shrunk.per_step
    by_hand = shrink(fqe.difference, own, 0.4, members=4, episodes=30, confidence=0.95)
    assert shrunk.difference == by_hand.around(0.0, 0.95) and shrunk.value == by_hand.around(own.value, 0.95)
    assert shrunk.difference.value > fqe.difference.value == pytest.approx(-2.0)  # 40 % unlike: less is expected
    assert shrunk.figures["weight_fqe"] == by_hand.weight and shrunk.probability_better == by_hand.better
    assert shrunk.per_step.high == pytest.approx(shrunk.value.high / HORIZON)
    (found,) = of_policy(off=50.0).valuations(("shrunk",))
    assert found["shrunk"].verdict == "refused" and "fitted Q gives" in found["shrunk"].reason


def test_rare_actions_refuse_only_where_no_model_says_what_they_lead_to():
    many = of_policy(off=0.0, unlike=0.9)
    assert many.valuations(("model",))[0]["model"].verdict == "better"
    assert many.valuations(("model",))[0].unlike_states == 0.0
    del many.by_members["model"]
    many.unknown = None
    (found,) = many.valuations(("fqe",))
    assert found["fqe"].verdict == "refused" and "90% of the policy's actions are unlike" in found["fqe"].reason
    assert found.unlike_states is None


def test_a_model_that_leads_the_behaviour_itself_astray_has_no_say():
    made = of_policy(off=0.0)
    made.by_members["model"] = dataclasses.replace(made.by_members["model"], strays=0.6)
    (found,) = made.valuations(("fqe", "model", "blend"))
    assert [each.verdict for each in found.estimates] == ["worse", "refused", "worse"]
    assert "60% of the states that the model leads whoever wrote the log to" in found["model"].reason
    assert found.unlike_states is None and "weight_model" not in found["blend"].figures
    rare = of_policy(off=0.0, unlike=0.9)
    rare.by_members["model"] = dataclasses.replace(rare.by_members["model"], strays=0.6)
    (found,) = rare.valuations(("fqe",))
    assert found["fqe"].verdict == "refused" and "90% of the policy's actions are unlike" in found["fqe"].reason


def test_where_both_controls_fail_the_blend_is_refused_for_both_reasons():
    made = of_policy(off=50.0)
    made.by_members["model"] = made.by_members["fqe"]
    (found,) = made.valuations(("blend",))
    assert found["blend"].verdict == "refused"
    assert "fitted Q gives" in found["blend"].reason and "the model gives" in found["blend"].reason
    assert found.unlike_states is None
