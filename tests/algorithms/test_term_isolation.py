"""Terms change what they should and nothing else: weight 0 is the base, and one term is deaf to another."""

import jax
import jax.random as jr
import numpy as np
import pytest

from golden import tiny
from odaf.algorithms import config
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.terms import OODPessimism, OutcomePenalty
from odaf.experiments import presets

SMALL_DYNAMICS = {"outcome.dynamics.hidden_sizes": (5, 4), "outcome.dynamics.latent_dim": 3, "outcome.num_draws": 3}


def _preset(name: str, **changes):
    learner = presets.load(name)
    names = [term.name for term in learner.terms]
    small = SMALL_DYNAMICS if "outcome" in names else {}
    return config.replace(learner, {**tiny.SMALL, **small, **changes})


def _trained(learner, updates: int = 3):
    """State and metrics after some compiled updates."""

    @jax.jit
    def train(key):
        side = learner.untrained_side(jr.fold_in(key, 1), tiny.SPEC)
        state = learner.init(jr.fold_in(key, 2), tiny.SPEC, side)
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
    ],
)
def test_a_weight_of_zero_is_the_base_bit_for_bit(with_term, change, base):
    state, metrics = _trained(_preset(with_term, **change))
    bare, bare_metrics = _trained(_preset(base))
    assert jax.tree.structure(state) == jax.tree.structure(bare)
    tiny.assert_same_bits(state, bare)
    assert metrics.keys() == bare_metrics.keys()


def _one_update(terms):
    """State, metrics and noise of one update, op by op, with the given terms."""
    learner = EnsembleSAC(**tiny.SMALL, terms=terms)
    with tiny.exactly():
        sides = {"outcome": tiny.dynamics_model(tiny.dynamics_config()), "ood": ()}
        state = tiny.state_of(learner, side=tuple(sides[term.name] for term in terms))
        return learner.update(state, tiny.batch(), jr.key(1))


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
        for name in ("critics", "target_critics", "critic_optimiser", "log_temperature"):
            tiny.assert_same_bits(getattr(one, name), getattr(other, name))
        assert not np.array_equal(one.actor.network.weights[0], other.actor.network.weights[0])
    for one, other in ((pulled, bare), (both, feared)):  # the pessimistic term moves the critics alone
        for name in ("actor", "slow_actor", "actor_optimiser", "log_temperature"):
            tiny.assert_same_bits(getattr(one, name), getattr(other, name))
        assert not np.array_equal(one.critics.networks.weights[0], other.critics.networks.weights[0])
    for metrics in (bare_metrics, pulled_metrics, feared_metrics, swapped_metrics):
        assert {name: both_metrics[name] for name in metrics} == metrics
    for name in ("actor", "critics", "log_temperature"):
        tiny.assert_same_bits(getattr(both, name), getattr(swapped, name))
