"""When the monitor speaks, and what it recommends."""

import pytest

from odaf.data.spec import Spec
from odaf.training.monitors import DivergenceMonitor, TrainingWarning, value_bounds


def _spec(low=0.0, high=1.0, terminates=False):
    return Spec(2, 1, (-1.0,), (1.0,), low, high, terminates, 200)


AS_PUBLISHED = {"critic_norm": "none", "value_range": "none", "entropy_in_backup": True, "terms": []}


def _monitor(settings=None, **spec):
    return DivergenceMonitor(_spec(**spec), 0.99, AS_PUBLISHED if settings is None else settings)


@pytest.mark.parametrize(
    ("spec", "expected"),
    [
        ({}, (0.0, 100.0)),
        ({"low": 0.5, "high": 1.0}, (0.0, 100.0)),  # fresh critics start at 0, below the least value of 50
        ({"low": -2.0, "high": -1.0}, (-200.0, 0.0)),
        ({"low": -1.0, "high": 3.0, "terminates": True}, (-100.0, 300.0)),
    ],
)
def test_value_bounds_follow_from_rewards(spec, expected):
    assert value_bounds(_spec(**spec), 0.99) == pytest.approx(expected)


def test_values_inside_the_range_and_a_little_outside_are_fine():
    metrics = {"critic/max": 109.0, "critic/min": -9.0, "temperature/value": 9.9, "actor/loss": -1e9}
    assert _monitor().observe(1000, metrics) == []


@pytest.mark.parametrize(
    ("metrics", "kind", "words"),
    [
        ({"critic/max": 111.0}, "above-range", ["critic/max is 111", "from 0 to 100", "OODPessimism"]),
        ({"critic/min": -11.0}, "below-range", ["critic/min is -11", "smaller weight of the pessimistic term"]),
        ({"temperature/value": 18.0}, "temperature", ["temperature/value is 18", "entropy_in_backup=False"]),
        ({"actor/loss": float("nan"), "critic/max": float("inf")}, "not-finite", ["actor/loss, critic/max"]),
    ],
)
def test_each_failure_is_named_once_with_cause_and_remedy(metrics, kind, words):
    monitor = _monitor()
    (warning,) = monitor.observe(3000, metrics)
    assert (warning.kind, warning.step) == (kind, 3000)
    for word in ["update 3,000", "Likely cause", "What helps", 'critic_norm="layer"', 'value_range="auto"', *words]:
        assert word in warning.message
    assert monitor.observe(4000, metrics) == []
    assert TrainingWarning(**warning.to_dict()) == warning


def test_several_failures_at_once_are_several_warnings():
    found = _monitor().observe(1, {"critic/max": 1e4, "critic/min": -1e4, "temperature/value": 20.0})
    assert {warning.kind for warning in found} == {"above-range", "below-range", "temperature"}


def test_options_that_are_in_use_are_not_recommended():
    settings = {"critic_norm": "layer", "value_range": "auto", "target": {"entropy_in_backup": False}}
    (warning,) = _monitor(settings).observe(1, {"critic/max": 1e4})
    for option in ("critic_norm", "value_range", "entropy_in_backup"):
        assert option not in warning.message
    assert "OODPessimism" not in warning.message  # the learner has no terms
    (warning,) = _monitor(settings | {"value_range": "none"}).observe(1, {"temperature/value": 11.0})
    assert 'value_range="auto"' in warning.message and "critic_norm" not in warning.message
    (warning,) = _monitor(settings).observe(1, {"temperature/value": 11.0})
    assert "a smaller learning rate" in warning.message  # never an empty recommendation


def test_a_learner_without_critics_is_told_of_none_of_their_options():
    monitor = DivergenceMonitor(_spec(), None, {"kind": "behaviour-cloning", "learning_rate": 3e-4})
    assert monitor.observe(1, {"critic/max": 1e9}) == []  # without a discount no value is out of range
    (warning,) = monitor.observe(2, {"actor/loss": float("nan")})
    assert "a smaller learning rate" in warning.message
    assert not any(word in warning.message for word in ("critic_norm", "value_range", "OODPessimism"))


def test_resumed_monitor_does_not_repeat_itself():
    monitor = DivergenceMonitor(_spec(), 0.99, {}, seen={"above-range"})
    assert monitor.observe(5000, {"critic/max": 1e4}) == []
