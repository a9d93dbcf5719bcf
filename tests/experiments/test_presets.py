"""Presets: files that load, extend one another, and say what they stand for."""

import subprocess
import sys
from typing import Any

import pytest

from odaf.algorithms import config
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.terms import OODPessimism, OutcomePenalty
from odaf.errors import ConfigError
from odaf.experiments import methods, presets

ALL = (
    "behaviour-cloning",
    "odaf",
    "odaf-paper",
    "odaf-paper-without-outcome",
    "odaf-pessimistic",
    "odaf-pessimistic-without-outcome",
    "odaf-without-outcome",
    "sac-n",
)


def _terms(name: str) -> dict[str, Any]:
    return {term.name: term for term in presets.load(name).terms}


def test_the_promised_presets_are_there_and_described():
    described = presets.names()
    assert set(ALL) <= set(described)
    assert all(len(text) > 20 for text in described.values())
    for name in described:
        assert presets.settings(name)["source"], name


@pytest.mark.parametrize("name", ALL)
def test_every_preset_loads_and_survives_its_own_configuration(name):
    learner = presets.load(name)
    assert config.from_dict(config.to_dict(learner)) == learner
    assert type(learner) is (BehaviourCloning if name == "behaviour-cloning" else EnsembleSAC)


def test_sac_n_is_as_published():
    learner = presets.load("sac-n")
    assert learner.terms == () and learner.num_critics == 10 and learner.entropy_in_backup
    assert (learner.critic_norm, learner.value_range, learner.actor_critic) == ("none", "none", "online")
    rates = (learner.actor_learning_rate, learner.critic_learning_rate, learner.temperature_learning_rate)
    assert rates == (3e-4, 3e-4, 3e-4) and learner.target_rate == 5e-3 and learner.discount == 0.99


def test_the_literal_preset_is_as_printed():
    learner = presets.load("odaf-paper")
    assert (learner.critic_norm, learner.value_range, learner.entropy_in_backup) == ("none", "none", True)
    assert learner.actor_critic == "target" and learner.hidden_sizes == (256, 256) and learner.num_critics == 10
    (term,) = learner.terms
    assert isinstance(term, OutcomePenalty)
    assert (term.weight, term.solver, term.num_draws, term.reduce) == (0.3, "sample", 20, "max")
    assert (term.next_policy, term.std_ddof, term.detach_next_action, term.num_states) == ("slow", 0, False, None)
    model = term.dynamics
    assert (model.kind, model.encoder, model.residual, model.latent_dim) == ("cvae", "state-action", False, 32)
    assert (model.steps, model.learning_rate, model.schedule) == (10_000, 1e-4, "constant")


def test_the_default_is_stabilised_and_carries_the_term():
    learner = presets.load("odaf")
    assert (learner.critic_norm, learner.value_range, learner.entropy_in_backup) == ("layer", "auto", False)
    (term,) = learner.terms
    assert isinstance(term, OutcomePenalty) and term.weight > 0.0 and term.solver == "gradient"
    assert isinstance(_terms("odaf-pessimistic")["ood"], OODPessimism)


@pytest.mark.parametrize("name", ["odaf", "odaf-paper", "odaf-pessimistic"])
def test_without_outcome_differs_by_that_term_and_nothing_else(name):
    whole, base = config.to_dict(presets.load(name)), config.to_dict(presets.load(f"{name}-without-outcome"))
    assert "outcome" in [term["name"] for term in whole["terms"]]
    whole["terms"] = [term for term in whole["terms"] if term["name"] != "outcome"]
    assert whole == base


def test_overrides_by_dotted_name():
    learner = presets.load("odaf", {"num_critics": 4, "outcome.weight": 1, "outcome.dynamics.kind": "ensemble"})
    assert learner.num_critics == 4
    assert learner.terms[0].weight == 1.0 and learner.terms[0].dynamics.kind == "ensemble"
    assert learner.terms[0].radius == presets.load("odaf").terms[0].radius


def test_names_that_are_not_known_are_answered_with_those_that_are():
    with pytest.raises(ConfigError, match="preset 'odaff' does not exist; known: .*odaf, odaf-paper"):
        presets.load("odaff")
    with pytest.raises(ConfigError, match="preset odaf: unknown field 'criticks'; known here: .*num_critics"):
        presets.load("odaf", {"criticks": 3})
    with pytest.raises(ConfigError, match="preset sac-n: 'outcome.weight' names no term.*its terms: none"):
        presets.load("sac-n", {"outcome.weight": 3})


def test_methods_take_a_terms_fields_as_a_table():
    assert methods.ODAF() == presets.load("odaf")
    table = methods.ODAF(num_critics=4, outcome={"weight": 1.0, "dynamics": {"kind": "ensemble"}})
    dotted = {"num_critics": 4, "outcome.weight": 1.0, "outcome.dynamics.kind": "ensemble"}
    assert table == presets.load("odaf", dotted)
    assert methods.preset("sac-n", discount=0.9).discount == 0.9


def test_listing_presets_loads_no_array_library():
    code = (
        "import sys\nfrom odaf.experiments import presets\npresets.names(); presets.settings('odaf')\n"
        "print(*(m for m in sys.modules if m in ('jax', 'equinox', 'optax')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
