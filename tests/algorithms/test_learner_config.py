"""Learners to dictionaries and back, overrides by dotted name, and messages for what is not known."""

import dataclasses
import json
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from odaf.algorithms import config
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.registry import ALGORITHMS
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
from odaf.components.dynamics import DynamicsConfig
from odaf.components.inverse_dynamics import InverseDynamicsConfig
from odaf.errors import ConfigError


@dataclasses.dataclass(frozen=True)
class Recipe:
    """A class and its arguments. Built in the test: the type checks draw random numbers, which a strategy must not."""

    cls: type
    arguments: dict[str, Any]

    def build(self) -> Any:
        def built(value: Any) -> Any:
            if isinstance(value, tuple):
                return tuple(built(item) for item in value)
            return value.build() if isinstance(value, Recipe) else value

        return self.cls(**{name: built(value) for name, value in self.arguments.items()})


def _settings(cls: type, **arguments: st.SearchStrategy) -> st.SearchStrategy[Recipe]:
    return st.fixed_dictionaries(arguments).map(lambda values: Recipe(cls, values))


counts = st.integers(1, 500)
sizes = st.lists(counts, min_size=1, max_size=3).map(tuple)
amounts = st.floats(0.0, 1e6)
rates = st.floats(1e-8, 1.0)

dynamics_models = _settings(
    DynamicsConfig,
    kind=st.sampled_from(["deterministic", "ensemble", "cvae"]),
    hidden_sizes=sizes,
    residual=st.booleans(),
    steps=counts,
    batch_size=counts,
    learning_rate=rates,
    schedule=st.sampled_from(["cosine", "constant"]),
    holdout=st.floats(0.01, 0.99),
    members=st.integers(5, 9),
    elites=st.integers(1, 5),
    latent_dim=counts,
    encoder=st.sampled_from(["state-action", "transition"]),
)
outcome_terms = _settings(
    OutcomePenalty,
    weight=amounts,
    radius=amounts,
    solver=st.just("sample"),
    reduce=st.sampled_from(["max", "mean"]),
    num_states=st.none() | counts,
    include_centre=st.booleans(),
    next_policy=st.sampled_from(["slow", "current"]),
    std_ddof=st.sampled_from([0, 1]),
    dynamics=dynamics_models,
)
ood_terms = _settings(
    OODPessimism,
    weight=amounts,
    num_actions=counts,
    next_deviations=st.none() | amounts,
    floor=st.none() | st.floats(-10, 10),
    decay_steps=counts,
)
inverse_models = _settings(
    InverseDynamicsConfig,
    hidden_sizes=sizes,
    latent_dim=counts,
    encode_target=st.booleans(),
    log_std_min=st.floats(-20.0, 1.0),
    steps=counts,
    schedule=st.sampled_from(["cosine", "constant"]),
)
other_terms = (
    _settings(GradientDiversity, weight=amounts)
    | _settings(PolicySmoothing, weight=amounts, radius=amounts, num_draws=counts, shared_draws=st.booleans())
    | _settings(ValueSmoothing, weight=amounts, radius=amounts, fall_weight=st.floats(0.0, 1.0))
    | _settings(InverseDynamicsAlignment, weight=amounts, state_noise=amounts, model=inverse_models)
    | _settings(InverseDynamicsValues, weight=amounts, num_actions=counts, model=inverse_models)
    | _settings(Conservative, weight=amounts, num_actions=counts)
    | _settings(BehaviourDistance, weight=amounts, target_weight=amounts)
    | _settings(StateDeviation, weight=amounts, num_draws=counts, kernel_width=st.none() | rates)
)
learners = _settings(
    EnsembleSAC,
    num_critics=st.integers(2, 100),
    hidden_sizes=sizes,
    critic_norm=st.sampled_from(["layer", "none"]),
    value_range=st.sampled_from(["auto", "none"]),
    entropy_in_backup=st.booleans(),
    actor_critic=st.sampled_from(["online", "target"]),
    discount=st.floats(0.0, 0.999),
    target_rate=rates,
    batch_size=counts,
    initial_temperature=rates,
    target_entropy=st.none() | st.floats(-10, 10),
    terms=st.one_of(
        st.just(()), st.tuples(outcome_terms), st.tuples(ood_terms), st.tuples(outcome_terms, ood_terms, other_terms)
    ),
) | _settings(BehaviourCloning, hidden_sizes=sizes, learning_rate=rates, batch_size=counts)


@settings(max_examples=60)
@given(learners)
def test_a_learner_survives_json(recipe):
    learner = recipe.build()
    plain = json.loads(json.dumps(config.to_dict(learner)))
    again = config.from_dict(plain)
    assert again == learner and type(again) is type(learner)


def test_every_field_is_written_even_defaults():
    plain = config.to_dict(EnsembleSAC(terms=(OutcomePenalty(),)))
    assert set(plain) == {"kind"} | {field.name for field in dataclasses.fields(EnsembleSAC)}
    (term,) = plain["terms"]
    assert set(term) == {"name"} | {field.name for field in dataclasses.fields(OutcomePenalty)}
    assert set(term["dynamics"]) == {field.name for field in dataclasses.fields(DynamicsConfig)}


def test_missing_fields_keep_their_defaults_and_whole_numbers_become_floats():
    learner = config.from_dict({"kind": "ensemble-sac", "discount": 0, "terms": [{"name": "outcome", "weight": 2}]})
    assert learner == EnsembleSAC(discount=0.0, terms=(OutcomePenalty(weight=2.0),))
    assert isinstance(learner, EnsembleSAC) and type(learner.discount) is float


BASE = EnsembleSAC(terms=(OutcomePenalty(), OODPessimism()))


def test_overrides_reach_fields_terms_and_what_is_inside_terms():
    changed = config.replace(
        BASE,
        {
            "num_critics": 4,
            "hidden_sizes": [64],
            "outcome.weight": 2,
            "outcome.dynamics.kind": "cvae",
            "ood.floor": 0.0,
            "target_entropy": -3,
        },
    )
    assert changed == EnsembleSAC(
        num_critics=4,
        hidden_sizes=(64,),
        target_entropy=-3.0,
        terms=(OutcomePenalty(weight=2.0, dynamics=DynamicsConfig(kind="cvae")), OODPessimism(floor=0.0)),
    )
    assert EnsembleSAC(terms=(OutcomePenalty(), OODPessimism())) == BASE, "the original is left alone"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"num_critic": 3}, "here: unknown field 'num_critic'; known here: .*num_critics"),
        ({"outcome.wait": 3}, "unknown field 'outcome.wait'.*weight"),
        ({"outcome.dynamics.kindd": "x"}, "unknown field 'outcome.dynamics.kindd'.*kind"),
        ({"outcome.weight.more": 3}, "unknown field 'outcome.weight.more'"),
        ({"edac.weight": 3}, "'edac.weight' names no term of this learner; its terms: outcome, ood"),
        ({"kind": "behaviour-cloning"}, "unknown field 'kind'"),
        ({"outcome.name": "ood"}, "unknown field 'outcome.name'"),
        ({"terms": []}, "unknown field 'terms'"),
        ({"num_critics": 2.5}, "ensemble-sac.num_critics=2.5 is not of the expected kind: int"),
        ({"num_critics": True}, "num_critics=True is not of the expected kind: int"),
        ({"entropy_in_backup": 1}, "entropy_in_backup=1 is not of the expected kind: bool"),
        ({"critic_norm": "batch"}, "critic_norm='batch' is not of the expected kind: 'layer' | 'none'"),
        ({"hidden_sizes": [64, "x"]}, "hidden_sizes='x' is not of the expected kind: int"),
        ({"hidden_sizes": 64}, "hidden_sizes=64 is not of the expected kind"),
        ({"discount": "high"}, "discount='high' is not of the expected kind: float"),
        ({"outcome.dynamics": "cvae"}, "outcome.dynamics='cvae' is not of the expected kind: DynamicsConfig"),
        ({"discount": 1.5}, r"discount=1.5 must lie in \[0, 1\)"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_overrides_that_fit_nowhere_are_named_with_what_is_known(changes, message):
    with pytest.raises(ConfigError, match=message):
        config.replace(BASE, changes, "here")


def test_a_learner_without_terms_says_so():
    with pytest.raises(ConfigError, match="its terms: none"):
        config.replace(BehaviourCloning(), {"outcome.weight": 1.0})


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({}, "FILE: kind=None is not a learner; known: ensemble-sac, behaviour-cloning"),
        ({"kind": "td3"}, "FILE: kind='td3' is not a learner"),
        ({"kind": "ensemble-sac", "critics": 3}, "FILE: ensemble-sac has no field 'critics'; known: .*, num_critics"),
        (
            {"kind": "ensemble-sac", "terms": [{"name": "edac"}]},
            "FILE: name='edac' is not a term; known: outcome, ood, diversity",
        ),
        ({"kind": "ensemble-sac", "terms": [{"weight": 1.0}]}, "FILE: name=None is not a term"),
        ({"kind": "ensemble-sac", "terms": ["outcome"]}, "FILE: a term must be a table with a name, got 'outcome'"),
        ({"kind": "ensemble-sac", "terms": "outcome"}, "FILE: terms='outcome'"),
        ({"kind": "ensemble-sac", "terms": [{"name": "ood", "draws": 3}]}, "FILE: ood has no field 'draws'"),
        (
            {"kind": "ensemble-sac", "terms": [{"name": "outcome", "dynamics": {"depth": 3}}]},
            "FILE: outcome.dynamics has no field 'depth'; known: kind",
        ),
    ],
)
def test_a_configuration_that_cannot_be_built_is_explained(fields, message):
    with pytest.raises(ConfigError, match=message):
        config.from_dict(fields, "FILE")


def test_the_word_none_stands_for_no_value_where_there_may_be_none():
    changes = {"outcome.num_states": "none", "critic_norm": "none"}
    learner = config.replace(EnsembleSAC(terms=(OutcomePenalty(num_states=8),)), changes)
    assert isinstance(learner, EnsembleSAC) and learner.critic_norm == "none"
    assert getattr(learner.terms[0], "num_states", 0) is None


@pytest.mark.parametrize(
    ("setting", "value", "message"),
    [
        ("learning_rate", -1e-3, "learning_rate=-0.001 must not be negative"),
        ("learning_rate", math.nan, "learning_rate=nan must be a finite number"),
        ("normaliser_epsilon", math.inf, "normaliser_epsilon=inf must be a finite number"),
        ("hidden_sizes", (8, 0), r"hidden_sizes=\(8, 0\) must hold widths of at least 1"),
        ("batch_size", 0, "batch_size=0 must be at least 1"),
        ("actor_kind", "squashed", "actor_kind='squashed' is not of the expected kind: 'deterministic' | 'gaussian'"),
    ],
)
def test_settings_that_no_learner_can_have_are_refused_where_a_learner_is_made_of_them(setting, value, message):
    with pytest.raises(ConfigError, match=message):
        config.replace(BehaviourCloning(), {setting: value})


def test_rates_of_terms_and_models_are_looked_at_too():
    learner = EnsembleSAC(terms=(OutcomePenalty(dynamics=DynamicsConfig(learning_rate=-1.0)),))
    with pytest.raises(ConfigError, match="outcome.dynamics.learning_rate=-1.0 must not be negative"):
        config.checked(learner)


def test_what_a_learner_calls_its_warm_up_is_a_setting_that_counts_updates():
    named = {kind: cls.warm_up for kind, cls in ALGORITHMS.items() if cls.warm_up is not None}
    assert named.keys() >= {"atac", "bear", "brac", "cql"}
    assert all(isinstance(getattr(ALGORITHMS[kind](), field), int) for kind, field in named.items())
