"""Terms change what they should and nothing else: weight 0 is the base, and one term is deaf to another."""

import functools

import jax
import jax.random as jr
import numpy as np
import pytest

from golden import tiny
from odaf.algorithms import config
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.registry import TERMS
from odaf.algorithms.terms import (
    BehaviourDistance,
    Conservative,
    GradientDiversity,
    InverseDynamicsAlignment,
    InverseDynamicsValues,
    OODPessimism,
    OutcomePenalty,
    PolicySmoothing,
    StateDeviation,
    ValueSmoothing,
)
from odaf.components.dynamics import untrained
from odaf.components.inverse_dynamics import InverseDynamicsConfig, untrained_inverse
from odaf.runs import presets

SMALL_TERMS = {
    "outcome.dynamics.hidden_sizes": (5, 4),
    "outcome.dynamics.latent_dim": 3,
    "outcome.num_draws": 3,
    "policy_smoothing.num_draws": 3,
    "value_smoothing.num_draws": 3,
    "inverse_dynamics.model.hidden_sizes": (5, 4),
    "inverse_dynamics.model.latent_dim": 3,
    "inverse_dynamics_values.model.hidden_sizes": (5, 4),
    "inverse_dynamics_values.model.latent_dim": 3,
}
TRANSITIONS = tiny.dynamics_config(kind="cvae", encoder="transition")
INVERSE = InverseDynamicsConfig(hidden_sizes=(5, 4), latent_dim=3)


def _preset(name: str, **changes):
    learner = presets.load(name)
    names = [term.name for term in learner.terms]
    small = {field: value for field, value in SMALL_TERMS.items() if field.partition(".")[0] in names}
    return config.replace(learner, {**tiny.SMALL, **small, **changes})


@functools.cache  # several terms have one base
def _trained(learner, updates: int = 3):
    """State and metrics after some compiled updates."""

    @jax.jit
    def train(key):
        models = learner.untrained(jr.fold_in(key, 1), tiny.SPEC)
        state = learner.init(jr.fold_in(key, 2), tiny.SPEC, models)
        keys = jr.split(jr.fold_in(key, 3), updates)
        return jax.lax.scan(lambda s, k: learner.update(s, tiny.batch(), k), state, keys)

    return train(jr.key(0))


@pytest.mark.parametrize(
    ("with_term", "change", "base"),
    [
        ("odaf", {"outcome.weight": 0.0}, "odaf-without-outcome"),
        ("odaf-paper", {"outcome.weight": 0.0}, "odaf-paper-without-outcome"),
        ("odaf-pessimistic", {"ood.weight": 0.0}, "odaf"),
        ("odaf-pessimistic", {"outcome.weight": 0.0}, "odaf-pessimistic-without-outcome"),
        ("odaf-locomotion", {"outcome.weight": 0.0}, "odaf-locomotion-without-outcome"),
        ("edac", {"diversity.weight": 0.0}, "sac-n"),
        ("rorl", {"policy_smoothing.weight": 0.0, "value_smoothing.weight": 0.0, "ood.weight": 0.0}, "sac-n"),
        ("odaf-rorl", {"outcome.weight": 0.0}, "rorl"),
        ("osr-10", {"inverse_dynamics.weight": 0.0}, "odaf-paper-without-outcome"),
    ],
)
def test_a_weight_of_zero_is_the_base_bit_for_bit(with_term, change, base):
    state, metrics = _trained(_preset(with_term, **change))
    bare, bare_metrics = _trained(_preset(base))
    assert jax.tree.structure(state) == jax.tree.structure(bare)
    tiny.assert_same_bits(state, bare)
    assert metrics.keys() == bare_metrics.keys()


def _model(name: str):
    """A model with random parameters, for the terms that have one."""
    if name == "outcome":
        return tiny.dynamics_model(tiny.dynamics_config())
    if name.startswith("inverse_dynamics"):
        return tiny.filled(jax.eval_shape(lambda: untrained_inverse(INVERSE, jr.key(0), tiny.OBS_DIM, tiny.ACT_DIM)), 6)
    if name == "state_deviation":
        transitions = jax.eval_shape(lambda: untrained(TRANSITIONS, jr.key(0), tiny.OBS_DIM, 0))
        return tiny.dynamics_model(tiny.dynamics_config(kind="ensemble")), tiny.filled(transitions, 6)
    return ()


@functools.cache
def _one_update(terms):
    """State and metrics of one update, op by op, with the given terms."""
    learner = EnsembleSAC(**tiny.SMALL, terms=terms)
    with tiny.exactly():
        state = tiny.state_of(learner, models=tuple(_model(term.name) for term in terms))
        return learner.update(state, tiny.batch(), jr.key(1))


EACH = (
    OODPessimism(num_actions=2, radius=0.1),
    OutcomePenalty(weight=5.0, dynamics=tiny.dynamics_config()),
    GradientDiversity(),
    PolicySmoothing(weight=1.0, radius=0.1, num_draws=2),
    ValueSmoothing(weight=1.0, radius=0.1, num_draws=2),
    InverseDynamicsAlignment(model=INVERSE),
    InverseDynamicsValues(num_actions=2, model=INVERSE),
    Conservative(num_actions=2),
    StateDeviation(num_draws=2, dynamics=tiny.dynamics_config(kind="ensemble"), transitions=TRANSITIONS),
    BehaviourDistance(),
)


def test_every_term_there_is_stands_in_the_list():
    assert {term.name for term in EACH} == set(TERMS)


@pytest.mark.parametrize("term", EACH, ids=lambda term: term.name)
def test_a_term_moves_what_it_says_and_leaves_the_rest_alone(term):
    bare, bare_metrics = _one_update(())
    state, metrics = _one_update((term,))
    assert term.acts_on_actor != term.acts_on_critics
    moved, still = ("actor", "critics") if term.acts_on_actor else ("critics", "actor")
    for name in (still, "log_temperature"):
        tiny.assert_same_bits(getattr(state, name), getattr(bare, name))
    for part in ("now", "slow", "moments"):
        pair = getattr(getattr(state, moved), part), getattr(getattr(bare, moved), part)
        leaves = zip(*map(jax.tree.leaves, pair), strict=True)
        assert any(not np.array_equal(ours, theirs) for ours, theirs in leaves), part
    assert {name: metrics[name] for name in bare_metrics} == bare_metrics
    assert all(name.startswith(f"{term.name}/") for name in metrics.keys() - bare_metrics.keys())


def test_all_terms_together_leave_each_others_numbers_alone():
    _, metrics = _one_update(EACH)
    for term in EACH:
        _, own = _one_update((term,))
        assert {name: metrics[name] for name in own} == own


def test_terms_leave_each_others_and_the_bases_numbers_alone():
    """One update with and without a term: what the term does not add to is the same, bit for bit."""
    ood = OODPessimism(num_actions=2, radius=0.1)
    outcome = OutcomePenalty(weight=5.0, dynamics=tiny.dynamics_config())
    bare, bare_metrics = _one_update(())
    pulled, pulled_metrics = _one_update((ood,))
    feared, feared_metrics = _one_update((outcome,))
    both, both_metrics = _one_update((ood, outcome))
    swapped, swapped_metrics = _one_update((outcome, ood))

    for one, other in ((feared, bare), (both, pulled)):  # the outcome term moves the actor alone
        for name in ("critics", "log_temperature"):
            tiny.assert_same_bits(getattr(one, name), getattr(other, name))
        assert not np.array_equal(one.actor.now.network.weights[0], other.actor.now.network.weights[0])
    for one, other in ((pulled, bare), (both, feared)):  # the pessimistic term moves the critics alone
        for name in ("actor", "log_temperature"):
            tiny.assert_same_bits(getattr(one, name), getattr(other, name))
        assert not np.array_equal(one.critics.now.weights[0], other.critics.now.weights[0])
    for metrics in (bare_metrics, pulled_metrics, feared_metrics, swapped_metrics):
        assert {name: both_metrics[name] for name in metrics} == metrics
    for name in ("actor", "critics", "log_temperature"):
        tiny.assert_same_bits(getattr(both, name), getattr(swapped, name))
