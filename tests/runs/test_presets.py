"""Presets: files that load, extend one another, and say what they stand for."""

import subprocess
import sys
from typing import Any

import jax
import jax.numpy as jnp
import jax.random as jr
import pytest

from odaf.algorithms import config
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.terms import OODPessimism, OutcomePenalty
from odaf.data.spec import Spec
from odaf.data.transitions import Transitions
from odaf.errors import ConfigError
from odaf.runs import methods, presets

ALL = (
    "behaviour-cloning",
    "behaviour-cloning-10-percent",
    "behaviour-cloning-best",
    "behaviour-cloning-gaussian",
    "edac",
    "odaf",
    "odaf-demo",
    "odaf-demo-without-outcome",
    "odaf-locomotion",
    "odaf-locomotion-without-outcome",
    "odaf-paper",
    "odaf-paper-without-outcome",
    "odaf-pessimistic",
    "odaf-pessimistic-without-outcome",
    "odaf-rorl",
    "odaf-rorl-without-outcome",
    "odaf-without-outcome",
    "osr",
    "osr-10",
    "osr-v",
    "pbrl",
    "pbrl-prior",
    "rorl",
    "sac-n",
)
ROBOTS = ("halfcheetah", "hopper", "walker2d")
KINDS = ("random", "medium", "medium-expert", "medium-replay", "expert")
FIFTEEN = {f"{robot}-{kind}" for robot in ROBOTS for kind in KINDS}
ATTACKED = {f"{robot}-medium-attack" for robot in ROBOTS}


def _terms(name: str, task: str | None = None) -> dict[str, Any]:
    return {term.name: term for term in presets.load(name, task=task).terms}


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
    assert type(learner) is (BehaviourCloning if name.startswith("behaviour-cloning") else EnsembleSAC)


def test_ten_percent_cloning_takes_a_tenth_of_the_episodes_and_the_gaussian_all_rows():
    tenth = presets.load("behaviour-cloning-10-percent")
    assert (tenth.sampling, tenth.best_of, tenth.best_share) == ("best", "episodes", 0.1)
    assert (tenth.hidden_sizes, tenth.learning_rate, tenth.batch_size) == ((256, 256), 3e-4, 256)
    assert (tenth.normaliser_epsilon, tenth.actor_kind) == (1e-3, "deterministic")
    gaussian = presets.load("behaviour-cloning-gaussian")
    assert (gaussian.actor_kind, gaussian.sampling) == ("gaussian", "uniform")


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


@pytest.mark.parametrize(
    "name", ["odaf", "odaf-antmaze", "odaf-demo", "odaf-locomotion", "odaf-paper", "odaf-pessimistic", "odaf-rorl"]
)
def test_without_outcome_differs_by_that_term_and_nothing_else(name):
    whole, base = config.to_dict(presets.load(name)), config.to_dict(presets.load(f"{name}-without-outcome"))
    assert "outcome" in [term["name"] for term in whole["terms"]]
    whole["terms"] = [term for term in whole["terms"] if term["name"] != "outcome"]
    assert whole == base


def test_relatives_of_sac_n_differ_from_it_by_their_terms_and_a_layer():
    base = config.to_dict(presets.load("sac-n"))
    for name, terms in (
        ("edac", ["diversity"]),
        ("rorl", ["policy_smoothing", "value_smoothing", "ood"]),
        ("odaf-rorl", ["policy_smoothing", "value_smoothing", "ood", "outcome"]),
    ):
        learner = presets.load(name)
        assert [term.name for term in learner.terms] == terms
        assert learner.hidden_sizes == (256, 256, 256)
        assert config.to_dict(learner) | {"terms": [], "hidden_sizes": base["hidden_sizes"]} == base
    assert all(term.shared_draws for term in presets.load("rorl").terms), "as the released code draws"
    assert _terms("rorl")["ood"].std_ddof == 1


def test_odafs_term_is_the_same_on_both_bases():
    on_rorl, printed = _terms("odaf-rorl", "hopper-medium")["outcome"], _terms("odaf-paper", "hopper-medium")["outcome"]
    assert on_rorl == printed


def test_osr_10_is_odaf_with_another_term():
    osr, odaf = config.to_dict(presets.load("osr-10")), config.to_dict(presets.load("odaf-paper"))
    assert [term["name"] for term in osr["terms"]] == ["inverse_dynamics"]
    assert osr | {"terms": []} == odaf | {"terms": []}
    assert _terms("osr-10")["inverse_dynamics"].weight == 0.5


def test_osr_stands_on_a_conservative_base():
    learner = presets.load("osr")
    assert (learner.num_critics, learner.entropy_in_backup, learner.hidden_sizes) == (2, False, (256, 256))
    assert (learner.actor_learning_rate, learner.critic_learning_rate) == (1e-4, 3e-4)
    assert [term.name for term in learner.terms] == ["conservative", "inverse_dynamics"]
    conservative, back = learner.terms
    assert (conservative.weight, conservative.num_actions) == (5.0, 10)
    assert (back.weight, back.state_noise, back.model.steps, back.model.latent_dim) == (0.5, 1e-3, 7812, 32)
    values = presets.load("osr-v")
    assert [term.name for term in values.terms] == ["inverse_dynamics_values"]
    assert config.to_dict(values) | {"terms": []} == config.to_dict(learner) | {"terms": []}


@pytest.mark.parametrize(
    ("name", "tasks"),
    [
        ("edac", FIFTEEN),
        ("osr-10", FIFTEEN),
        *((name, FIFTEEN | ATTACKED) for name in ("rorl", "odaf-rorl", "odaf-rorl-without-outcome", "odaf-paper")),
        ("sac-n", set()),
    ],
)
def test_the_fifteen_tasks_load(name, tasks):
    assert set(presets.tasks(name)) == tasks
    for task in tasks:
        learner = presets.load(name, task=task)
        assert type(learner) is EnsembleSAC
        assert config.from_dict(config.to_dict(learner)) == learner


@pytest.mark.parametrize(
    ("task", "draws", "radii", "smoothing", "ood"),
    [
        # rows of the published table: n, eps_P and eps_Q, beta_P, (weight, radius, lambda, its end, 1 / fall a step)
        ("halfcheetah-random", 20, (0.001, 0.001), 0.1, None),
        ("halfcheetah-expert", 10, (0.005, 0.005), 0.1, None),
        ("hopper-medium-replay", 20, (0.005, 0.005), 0.1, (0.5, 0.01, 0.1, 0.0, 1e6)),
        ("walker2d-random", 20, (0.005, 0.005), 1.0, (0.5, 0.01, 5.0, 0.5, 1e5)),
        ("walker2d-medium", 20, (0.01, 0.01), 1.0, (0.1, 0.01, 1.0, 0.1, 2e6)),
        ("walker2d-medium-expert", 20, (0.01, 0.01), 1.0, (0.1, 0.01, 0.1, 0.1, 0.0)),
        ("halfcheetah-medium-attack", 20, (0.05, 0.03), 1.0, None),
        ("walker2d-medium-attack", 20, (0.07, 0.03), 0.5, (0.5, 0.03, 1.0, 0.1, 1e6)),
    ],
)
def test_rorls_tasks_are_as_published(task, draws, radii, smoothing, ood):
    terms = _terms("rorl", task)
    policy, value = terms["policy_smoothing"], terms["value_smoothing"]
    assert (policy.num_draws, value.num_draws, policy.weight, value.weight) == (draws, draws, smoothing, 1e-4)
    assert (policy.radius, value.radius, value.fall_weight) == (*radii, 0.2)
    if ood is None:
        assert terms["ood"].weight == 0.0
        return
    weight, radius, first, last, steps_a_unit = ood
    assert (terms["ood"].weight, terms["ood"].radius, terms["ood"].num_actions) == (weight, radius, draws)
    assert (terms["ood"].deviations, terms["ood"].final_deviations) == (first, last)
    assert terms["ood"].decay_steps == pytest.approx((first - last) * steps_a_unit)


def test_a_task_changes_the_preset_and_overrides_change_the_task():
    learner = presets.load("edac", task="hopper-medium")
    assert (learner.num_critics, learner.terms[0].weight) == (50, 1.0)
    assert presets.load("edac", task="walker2d-medium-expert").terms[0].weight == 5.0
    assert presets.load("edac", {"num_critics": 4}, task="hopper-medium").num_critics == 4
    assert methods.preset("edac", task="hopper-medium", num_critics=4) == presets.load(
        "edac", {"num_critics": 4}, task="hopper-medium"
    )
    assert _terms("odaf-rorl", "walker2d-medium")["outcome"].radius == 0.01
    assert _terms("odaf-rorl", "walker2d-medium")["policy_smoothing"].weight == 1.0, "its base has the task as well"
    assert _terms("odaf-rorl", "walker2d-medium-attack")["outcome"].radius == 0.07


def test_a_task_that_is_not_known_is_answered_with_those_that_are():
    with pytest.raises(ConfigError, match="preset edac has no values for the task 'ant'; known: .*hopper-medium"):
        presets.load("edac", task="ant")
    with pytest.raises(ConfigError, match="preset sac-n has no values for the task 'hopper-medium'; known: none"):
        presets.load("sac-n", task="hopper-medium")


def test_a_dropped_term_takes_its_task_values_with_it(monkeypatch):
    files = {"base": {"terms": [{"name": "outcome"}]}, "bare": {"extends": "base", "without": ["outcome"]}}
    monkeypatch.setattr(presets, "_read", lambda name: dict(files[name]))
    tables = {"maze": {"discount": 0.9, "outcome": {"radius": 1.0}}}
    monkeypatch.setattr(presets, "_task_file", lambda name: tables if name == "base" else {})
    assert presets.tasks("base") == {"maze": {"discount": 0.9, "outcome.radius": 1.0}}
    assert presets.tasks("bare") == {"maze": {"discount": 0.9}}


def test_overrides_by_dotted_name():
    learner = presets.load("odaf", {"num_critics": 4, "outcome.weight": 1, "outcome.dynamics.kind": "ensemble"})
    assert learner.num_critics == 4
    assert learner.terms[0].weight == 1.0 and learner.terms[0].dynamics.kind == "ensemble"
    assert learner.terms[0].radius == presets.load("odaf").terms[0].radius


def test_names_that_are_not_known_are_answered_with_those_that_are():
    with pytest.raises(ConfigError, match="preset 'odaff' does not exist; known: .*odaf, odaf-anchored, .*odaf-demo, "):
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
    assert methods.preset("sac-n", discount=0.9).view().discount == 0.9


def test_listing_presets_loads_no_array_library():
    code = (
        "import sys\nfrom odaf.runs import presets\npresets.names(); presets.settings('odaf')\n"
        "print(*(m for m in sys.modules if m in ('jax', 'equinox', 'optax')))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_pbrl_follows_its_own_members_and_pulls_down_twice():
    learner = presets.load("pbrl")
    assert (learner.target, learner.target_deviations, learner.entropy_in_backup) == ("member", 0.01, False)
    assert (learner.actor_learning_rate, learner.temperature_learning_rate) == (1e-4, 1e-4)
    assert learner.num_critics == 10, "the term's weight is one for each critic"
    term = _terms("pbrl")["ood"]
    assert (term.weight, term.num_actions, term.radius, term.floor, term.next_deviations) == (10.0, 10, 0.0, 0.0, 0.1)
    assert (term.deviations, term.final_deviations, term.decay_steps, term.adaptive) == (5.0, 1.0, 50_000, True)
    assert set(presets.tasks("pbrl")) == FIFTEEN
    assert not _terms("pbrl", "hopper-medium-expert")["ood"].adaptive
    expert = _terms("pbrl", "walker2d-expert")["ood"]
    assert (expert.deviations, expert.final_deviations, expert.adaptive) == (2.0, 2.0, False)
    assert config.to_dict(presets.load("pbrl-prior")) == config.to_dict(learner) | {"prior_scale": 1.0}


def test_the_released_codes_term_differs_from_the_printed_one():
    term = _terms("odaf-demo")["outcome"]
    assert (term.weight, term.reduce, term.shared_draws, term.std_ddof) == (0.1, "mean", True, 1)
    assert (term.next_policy, term.next_action_at, term.detach_next_action) == ("current", "perturbed", True)
    for task in FIFTEEN | ATTACKED:
        terms = _terms("odaf-demo", task)
        smoothing = terms["value_smoothing"]
        assert (terms["outcome"].radius, terms["outcome"].num_draws) == (smoothing.radius, smoothing.num_draws)


@pytest.mark.parametrize("name", ALL)
def test_an_update_returns_the_types_that_it_takes(name):
    """Else the second call would be compiled again."""
    algorithm = presets.load(name, {"hidden_sizes": (8, 8), "batch_size": 4})
    spec = Spec(3, 2, (-1.0, -1.0), (1.0, 1.0), 0.0, 1.0, False, 10)
    state = jax.eval_shape(lambda: algorithm.init(jr.key(0), spec, algorithm.untrained(jr.key(1), spec)))
    rows = Transitions(jnp.ones((4, 3)), jnp.zeros((4, 2)), jnp.ones(4), jnp.ones((4, 3)), jnp.zeros(4))

    def types(tree):
        return [(leaf.shape, leaf.dtype, leaf.weak_type) for leaf in jax.tree.leaves(tree)]

    assert types(jax.eval_shape(lambda state: algorithm.update(state, rows, jr.key(2))[0], state)) == types(state)
