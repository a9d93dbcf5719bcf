"""Verdicts: what holds, what does not, and what is left open and why."""

import pytest

from odaf.evaluation.statistics import difference
from odaf.studies.verdict import Part, decide

ABOVE, BELOW, OPEN = (1.0, 2.0, 3.0, 2.0), (-1.0, -2.0, -3.0, -2.0), (-1.0, 1.0, 2.0, -1.5)


def part(name: str, values: tuple[float, ...], **fields: object) -> Part:
    return Part(name, values, **fields)  # type: ignore[arg-type]


def test_a_claim_is_held_if_all_its_parts_are_above_zero() -> None:
    found = decide([part("a", ABOVE), part("b", (9.0, 9.5, 9.2))])
    assert found.verdict == "held" and found.part == "a" and found.seeds == 4 and found.reasons == ()
    plain = difference(list(ABOVE), [0.0] * 4, paired=True)
    assert found.interval == (plain.low, plain.high) and "one-sample t" in found.test


def test_one_part_below_zero_is_enough_not_to_hold_and_its_interval_is_corrected() -> None:
    found = decide([part("a", ABOVE), part("b", BELOW)])
    assert found.verdict == "not held" and found.part == "b" and "Bonferroni" in found.test
    corrected = difference(list(BELOW), [0.0] * 4, paired=True, confidence=0.975)
    assert found.interval == (corrected.low, corrected.high)
    # Below zero by its own interval, but not by one that many parts widen.
    weak = part("weak", (-1.0, -2.2, -0.6, -1.2))
    assert decide([weak]).verdict == "not held"
    among = decide([weak, *(part(str(number), ABOVE) for number in range(9))])
    assert among.verdict == "not decided" and among.enough is not None and among.enough > 4  # four did not


def test_what_is_open_is_said_with_the_seeds_that_would_decide() -> None:
    found = decide([part("a", ABOVE), part("b", OPEN)])
    assert found.verdict == "not decided" and found.part == "b" and found.reasons[0].startswith("b: +0.12")
    assert found.enough == difference(list(OPEN), [0.0] * 4, paired=True).enough
    assert f"about {found.enough:,} seeds would decide" in str(found)
    # A part that lies below refutes the claim long before one that is nearly nothing could be above.
    against = part("b", (-1.0, 1.0, -2.0, -2.5))
    found = decide([part("a", (-9.0, 9.1, 9.0, -9.0)), against])
    assert found.verdict == "not decided"
    assert found.enough == difference(list(against.first), [0.0] * 4, paired=True, confidence=0.975).enough
    assert decide([part("a", ()), against]).enough == found.enough  # whatever is missing


@pytest.mark.parametrize(
    ("missing", "reason"),
    [
        (part("b", ()), "b: no records"),
        (part("b", (5.0,)), "b: +5.00, one seed"),
        (part("b", BELOW, void="below its log"), "b: below its log"),
        (part("b", ABOVE, void="below its log"), "b: below its log"),
    ],
)
def test_parts_without_records_seeds_or_sense_decide_nothing(missing: Part, reason: str) -> None:
    found = decide([part("a", ABOVE), missing])
    assert found.verdict == "not decided" and found.reasons == (reason,) and found.enough is None


def test_pairs_are_subtracted_seed_by_seed_and_thresholds_are_exceeded() -> None:
    paired = Part("a", (10.0, 20.0, 30.0), (9.0, 18.9, 29.1))
    assert decide([paired]).verdict == "held" and "paired t" in decide([paired]).test
    assert decide([Part("a", (10.0, 20.0, 30.0), (9.0, 18.9, 29.1), paired=False)]).verdict == "not decided"
    assert decide([Part("a", (0.9, 0.91, 0.92), threshold=0.8)]).verdict == "held"
    assert decide([Part("a", (0.7, 0.71, 0.72), threshold=0.8)]).verdict == "not held"


def test_two_of_three_suffice_where_no_more_are_needed() -> None:
    strong = (2.0, 2.1, 1.9, 2.0)
    three = [part("a", strong), part("b", strong), part("c", BELOW)]
    found = decide(three, needed=2)
    assert found.verdict == "held" and "2 of them needed" in found.test and found.reasons[0].startswith("c: -2")
    assert decide(three).verdict == "not held"
    assert decide([part("a", strong), part("b", OPEN), part("c", BELOW)], needed=2).verdict == "not decided"
    weak = tuple(-value for value in strong)
    assert decide([part("a", strong), part("b", weak), part("c", weak)], needed=2).verdict == "not held"


def test_a_verdict_is_json() -> None:
    found = decide([part("a", OPEN), part("b", ())]).to_dict()
    assert set(found) >= {"verdict", "test", "seeds", "interval", "enough", "reasons"}
    assert found["figures"]["a"]["seeds"] == [4, 4] and found["seeds"] == 0
