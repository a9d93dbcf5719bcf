"""Attacks whose worst offset is known by hand, and what holds for all of them."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import optax
import pytest

from golden import attacks as golden
from golden.networks import mode, q_values, spread
from odaf.algorithms.behaviour_cloning import BehaviourCloning
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.components.critics import CriticEnsemble
from odaf.components.networks import MLP
from odaf.components.perturbations import draw_offsets
from odaf.components.policies import Actor, GaussianActor
from odaf.data.normalisation import Normaliser
from odaf.data.spec import Spec
from odaf.errors import ConfigError
from odaf.evaluation import attacks
from odaf.evaluation.attacks import (
    ATTACKS,
    AttackedActor,
    AttackedPolicy,
    Judge,
    ThreatModel,
    climb,
    harm_of,
    worst_offsets,
)
from odaf.training.policy import Policy

OBS, ACT, ROWS = 3, 2, 4
STD = jnp.asarray([0.5, 2.0, 0.0])  # one wide dimension, one that never moves
MEAN = jnp.asarray([1.0, -2.0, 3.0])


def _network(*layers: np.ndarray, bias: float = 0.0) -> MLP:
    weights = tuple(jnp.asarray(layer, jnp.float32) for layer in layers)
    biases = tuple(jnp.full((*layer.shape[:-2], layer.shape[-1]), bias, jnp.float32) for layer in layers)
    return MLP(weights, biases, (), (), "silu")


def _threat(actor, critics) -> tuple[AttackedActor, Judge]:
    return AttackedActor(actor, MEAN, STD + 1e-3), Judge(critics, MEAN, STD + 1e-3, (-1.0,) * ACT, (1.0,) * ACT)


def _linear_threat(slopes=(0.3, -0.2, 0.9), critics=(1.0, 2.0)) -> tuple[AttackedActor, Judge]:
    """mean(s) = slopes . s in one action dimension, log std 0; Q_k(s, a) = critics[k] * a."""
    actor = GaussianActor(_network(np.stack([slopes, np.zeros(OBS)], axis=1)))
    members = np.stack([np.array([[0.0]] * OBS + [[slope]]) for slope in critics])
    return _threat(actor, CriticEnsemble(_network(members)))


def _smooth_threat(seed=0) -> tuple[AttackedActor, Judge]:
    rng = np.random.default_rng(seed)
    actor = GaussianActor(_network(rng.normal(size=(OBS, 8)), rng.normal(size=(8, 2 * ACT)) / 3, bias=0.1))
    critics = CriticEnsemble(_network(rng.normal(size=(3, OBS + ACT, 8)), rng.normal(size=(3, 8, 1)), bias=0.1))
    return _threat(actor, critics)


def _observations(seed=5) -> jax.Array:
    noise = np.random.default_rng(seed).normal(size=(ROWS, OBS)).astype(np.float32)
    return MEAN[None] + STD[None] * jnp.asarray(noise)


@functools.partial(jax.jit, static_argnums=(0, 1))
def _compiled(name, rule, threat, observations, budget, key):
    if threat is not None and not ATTACKS[name].asks_critics:
        threat = (threat[0], None)
    return worst_offsets(ATTACKS[name], rule, threat, observations, STD, budget, key)


def _worst(name, threat, observations, budget=0.1, rule="pgd", key=0) -> np.ndarray:
    return np.asarray(_compiled(name, rule, threat, observations, jnp.float32(budget), jr.key(key)))


def _harm(objective, threat, observations, offsets) -> np.ndarray:
    asked: ThreatModel = (threat[0], None if objective == "action-diff" else threat[1])
    offsets = jnp.asarray(offsets)
    found = harm_of(objective, asked, observations)(offsets.reshape(-1, ROWS, OBS))
    return np.asarray(found).reshape(offsets.shape[:-1])


# ---- objectives ----------------------------------------------------------------------------------------------------


def test_the_action_difference_is_exact_for_the_smallest_offsets():
    # Means that differ by slopes . delta / scale with variances of 1: half the square there and half the square back.
    threat, observations = _linear_threat(), _observations()
    for size in (1e-1, 1e-3, 1e-5):
        offsets = np.full((ROWS, OBS), size, np.float32) * np.asarray(STD)
        clean, moved = (
            np.asarray(threat[0].gaussian(rows)[0], np.float64) for rows in (observations, observations + offsets)
        )
        found = _harm("action-diff", threat, observations, offsets)
        np.testing.assert_allclose(found, np.square(moved - clean).sum(axis=1), rtol=1e-5)
        assert (found > 0.0).all()


@pytest.mark.parametrize("objective", ["action-diff", "min-q", "min-q-std"])
def test_objectives_against_numpy(objective):
    threat, observations = _smooth_threat(), _observations()
    offsets = np.random.default_rng(1).normal(size=(ROWS, OBS)).astype(np.float32)
    mean, scale = np.asarray(MEAN, np.float64), np.asarray(STD, np.float64) + 1e-3
    clean = (np.asarray(observations, np.float64) - mean) / scale
    seen = (np.asarray(observations, np.float64) + offsets - mean) / scale
    if objective == "action-diff":
        (m, s), (n, t) = golden.gaussian_log(threat[0].actor, clean), golden.gaussian_log(threat[0].actor, seen)
        expected = [golden.symmetric_kl(m[row], s[row], n[row], t[row]) for row in range(ROWS)]
    else:
        values = q_values(threat[1].critics, clean, mode(threat[0].actor, seen))  # the critics are told the truth
        expected = -values.mean(axis=0) if objective == "min-q" else spread(values, 0)
    np.testing.assert_allclose(_harm(objective, threat, observations, offsets), expected, rtol=2e-3, atol=1e-4)


# ---- known worst corners -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["min-q-first-order", "min-q-mixed-order"])
def test_a_linear_policy_is_pushed_into_its_worst_corner(name):
    # Q grows with the action and the action with 0.3 s_0 - 0.2 s_1: down with s_0, up with s_1; s_2 cannot move.
    found = _worst(name, _linear_threat(), _observations())
    np.testing.assert_allclose(found, np.tile([-0.05, 0.2, 0.0], (ROWS, 1)), rtol=1e-6)


def test_the_largest_change_of_a_linear_policy_is_one_of_two_corners():
    found = _worst("action-diff-mixed-order", _linear_threat(), _observations())
    np.testing.assert_allclose(np.abs(found), np.tile([0.05, 0.2, 0.0], (ROWS, 1)), rtol=1e-6)
    assert (found[:, 0] * found[:, 1] < 0).all()


def test_disagreement_is_climbed_away_from_where_members_agree():
    # Q_1 = a and Q_2 = 2 a differ by |a|: the attack makes |a| larger, whichever sign it has.
    threat = _linear_threat()
    observations = jnp.asarray([[3.0, -2.0, 3.0], [-3.0, -2.0, 3.0]])
    found = _worst("min-q-std-first-order", threat, observations)
    clean = np.asarray(threat[0].gaussian(observations)[0])[:, 0]
    np.testing.assert_allclose(found, np.sign(clean)[:, None] * np.array([[0.05, -0.2, 0.0]]), rtol=1e-6)


# ---- draws ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["action-diff", "min-q", "min-q-std"])
def test_sampling_takes_the_best_of_its_draws(name):
    threat, observations, attack = _smooth_threat(), _observations(), ATTACKS[name]
    candidates = 50 if name == "action-diff" else 51
    unit = draw_offsets(jr.key(0), candidates, ROWS, OBS, 1.0, shared=False, include_centre=attack.with_clean)
    draws = np.asarray(unit * (jnp.float32(0.1) * STD)[None, None])
    harm = _harm(attack.objective, threat, observations, draws)
    expected = draws[harm.argmax(axis=0), np.arange(ROWS)]
    np.testing.assert_allclose(_worst(name, threat, observations), expected, rtol=1e-5, atol=1e-7)
    assert len(np.unique(expected[:, 0])) == ROWS, "each row has draws of its own"


def test_random_is_one_uniform_draw():
    found = np.concatenate([_worst("random", None, _observations(), key=key) for key in range(300)])
    assert 0.099 < np.abs(found[:, 0]).max() / 0.5 <= 0.1 and (found[:, 2] == 0).all()
    assert abs(found[:, 1].std() - 0.2 / np.sqrt(3)) < 0.006  # 1,200 draws: its standard error is 0.0015


def test_sampled_min_q_leaves_a_state_alone_that_is_worst_already():
    # With slopes 1 and -1 into the hidden layer Q = silu(a) + silu(-a), which is smallest at a = 0, the clean action.
    members = np.stack([np.array([[0.0, 0.0]] * OBS + [[1.0, -1.0]])] * 2)
    critics = CriticEnsemble(_network(members, np.ones((2, 2, 1))))
    threat = _threat(_linear_threat()[0].actor, critics)
    found = _worst("min-q", threat, jnp.tile(MEAN[None], (ROWS, 1)))
    np.testing.assert_array_equal(found, np.zeros((ROWS, OBS)))


@pytest.mark.parametrize("seed", range(5))
def test_sampled_min_q_is_never_above_the_clean_value(seed):
    threat, observations = _smooth_threat(seed), _observations(seed)
    found = _harm("min-q", threat, observations, _worst("min-q", threat, observations, 0.3, key=seed))
    assert (found >= _harm("min-q", threat, observations, np.zeros((ROWS, OBS), np.float32)) - 1e-6).all()


@pytest.mark.parametrize("objective", ["min-q", "action-diff"])
def test_climbing_finds_at_least_as_much_as_sampling(objective):
    threat, observations = _smooth_threat(3), _observations()
    sampled, mixed = (
        _harm(objective, threat, observations, _worst(name, threat, observations, 0.3))
        for name in (objective, f"{objective}-mixed-order")
    )
    assert (mixed >= sampled - 1e-6).all() and (mixed > sampled + 1e-4).any()


# ---- steps ---------------------------------------------------------------------------------------------------------


def test_the_published_step_is_that_of_a_fresh_adam():
    """A tenth of the budget along the sign, the same in wide and narrow dimensions; optax's own Adam agrees."""
    slopes = jnp.asarray([3.0, -4e-8, 0.0])

    def harm(offsets):
        return jnp.sum(offsets * slopes[None, None], axis=-1)

    budget, start = jnp.float32(0.2), jnp.asarray([[[0.01, 0.02, 0.0]]])
    wide = jnp.asarray([10.0, 10.0, 10.0])
    found = climb(harm, start, wide, budget, 1, "rorl") - start
    fresh = optax.adam(0.1 * 0.2)
    update, _ = fresh.update(-slopes, fresh.init(slopes))
    np.testing.assert_allclose(np.asarray(found)[0, 0], np.asarray(update), rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(np.asarray(found)[0, 0, 0], 0.02, rtol=1e-5)
    # A dimension whose box is narrower than a step goes to its edge.
    narrow = jnp.asarray([0.015, 10.0, 0.0])
    assert np.asarray(climb(harm, start, narrow, budget, 1, "rorl"))[0, 0, 0] == np.float32(0.015)


def test_the_projected_step_is_a_fifth_of_the_box():
    def harm(offsets):
        return jnp.sum(offsets * jnp.asarray([[[3.0, -4.0, 0.0]]]), axis=-1)

    found = climb(harm, jnp.zeros((1, 1, 3)), jnp.asarray([0.5, 2.0, 1.0]), jnp.float32(0.1), 3, "pgd")
    np.testing.assert_allclose(np.asarray(found)[0, 0], [0.3, -1.2, 0.0], rtol=1e-6)


@pytest.mark.parametrize(
    ("name", "rule"),
    [(name, "pgd") for name in ATTACKS] + [(name, "rorl") for name in ATTACKS if name.endswith("first-order")],
)
def test_the_box_is_never_left_and_an_empty_box_moves_nothing(name, rule):
    observations = _observations()
    for budget in (0.0, 0.05, 0.3):
        found = _worst(name, _smooth_threat(), observations, budget, rule)
        assert (np.abs(found) <= np.asarray(jnp.float32(budget) * STD)).all()
    assert (found != 0.0)[:, :2].any()


# ---- policies ------------------------------------------------------------------------------------------------------


SPEC = Spec(
    obs_dim=OBS, act_dim=ACT, action_low=(-1.0, 0.0), action_high=(1.0, 5.0), reward_min=0.0, reward_max=1.0,
    ever_terminates=False, max_episode_length=10,
)  # fmt: skip


def _trained(learner) -> tuple[Policy, Judge | None]:
    state, names = learner.init(jr.key(0), SPEC, learner.untrained(jr.key(1), SPEC)), ("a", "b", "c")
    normaliser = Normaliser(np.asarray(MEAN), np.asarray(STD), 1e-3)
    bounds = SPEC.action_low, SPEC.action_high
    policy = Policy(learner.actor(state), normaliser, *bounds, names, provenance={"learner": learner.kind})
    critics = learner.values(state)
    return policy, None if critics is None else Judge(critics, MEAN, STD + 1e-3, *bounds)


@pytest.fixture(scope="module")
def trained() -> tuple[Policy, Judge]:
    policy, judge = _trained(EnsembleSAC(num_critics=2, hidden_sizes=(4,)))
    assert judge is not None
    return policy, judge


def test_an_attacked_policy_acts_on_what_it_is_shown(trained):
    observations, (policy, judge) = np.asarray(_observations()), trained
    twin = AttackedPolicy(policy, ATTACKS["min-q"], 0.3, jr.key(1), judge=judge)
    first, second = (twin.shown(observations) for _ in range(2))
    attacked = AttackedPolicy(policy, ATTACKS["min-q"], 0.3, jr.key(1), judge=judge)
    np.testing.assert_array_equal(attacked(observations), policy(first))
    actions, carry = attacked.act(attacked.begin(ROWS), observations)
    np.testing.assert_array_equal(actions, policy(second))
    assert attacked.observe(carry, np.zeros(ROWS)) == carry
    assert (first != second)[:, :2].any(), "every step has draws of its own"
    assert (np.abs(first - observations) <= 0.3 * np.asarray(STD) * (1 + 1e-5) + 1e-6).all()


@pytest.mark.parametrize("name", ["random", "min-q", "action-diff-first-order"])
def test_without_a_budget_an_attacked_policy_is_the_policy(trained, name):
    observations, (policy, judge) = np.asarray(_observations()), trained
    asked = judge if ATTACKS[name].asks_critics else None
    attacked = AttackedPolicy(policy, ATTACKS[name], 0.0, jr.key(0), judge=asked)
    np.testing.assert_array_equal(attacked(observations), policy(observations))


def test_one_compilation_serves_all_budgets_steps_and_keys(trained, monkeypatch):
    traces, (policy, _) = [], trained
    plain = attacks.worst_offsets
    monkeypatch.setattr(attacks, "worst_offsets", lambda *given: (traces.append(1), plain(*given))[1])
    rows = np.concatenate([np.asarray(_observations())] * 3)  # as many as no other test has
    for budget, key in ((0.1, 0), (0.2, 1)):
        attacked = AttackedPolicy(policy, ATTACKS["random"], budget, jr.key(key))
        for _ in range(2):
            attacked(rows)
    assert len(traces) == 1


def test_a_policy_that_does_not_fit_is_refused_with_the_attacks_that_work():
    cloned, judge = _trained(BehaviourCloning(hidden_sizes=(4,)))
    assert judge is None
    for name, attack in ATTACKS.items():
        if name == "random":
            AttackedPolicy(cloned, attack, 0.1, jr.key(0))(np.asarray(_observations()))
            continue
        lacks = "asks critics.*Judge.of" if attack.asks_critics else "'behaviour-cloning' is.*min-q.*at random$"
        with pytest.raises(ConfigError, match=f"'{name}'.*{lacks}"):
            AttackedPolicy(cloned, attack, 0.1, jr.key(0))


class Remembering(Actor):
    def begin(self, rows):
        return jnp.zeros(rows)

    def act(self, carry, observations, key=None):
        return jnp.tanh(carry[:, None] + 0.0 * observations[:, :ACT]), carry + 1.0


def test_a_policy_with_a_memory_is_attacked_at_random_alone(trained):
    policy, judge = trained
    remembering = dataclasses.replace(policy, actor=Remembering())
    attacked = AttackedPolicy(remembering, ATTACKS["random"], 0.1, jr.key(0))
    carry = attacked.begin(ROWS)
    first, carry = attacked.act(carry, np.asarray(_observations()))
    second, _ = attacked.act(carry, np.asarray(_observations()))
    assert (first[:, 0] == 0.0).all() and (second[:, 0] > 0.5).all()
    for name in ("min-q", "action-diff"):
        with pytest.raises(ConfigError, match=f"'{name}'.*has a memory"):
            AttackedPolicy(remembering, ATTACKS[name], 0.1, jr.key(0), judge=judge if name == "min-q" else None)


# ---- critics of another run ----------------------------------------------------------------------------------------


def test_the_critics_see_the_truth_in_their_own_scale():
    """They are asked Q(s, mu(s + delta)): the attacked policy's normaliser shapes the action, the judge's the state."""
    cloned, _ = _trained(BehaviourCloning(hidden_sizes=(4,)))
    _, judge = _trained(EnsembleSAC(num_critics=3, hidden_sizes=(4,)))
    assert judge is not None
    other = Normaliser(np.array([0.5, 0.5, -1.0]), np.array([3.0, 1.0, 2.0]), 1e-3)
    judge = dataclasses.replace(judge, mean=jnp.asarray(other.mean), scale=jnp.asarray(other.scale))
    threat = attacks.threat_model(cloned, ATTACKS["min-q"], judge)
    assert threat is not None
    observations, offsets = np.asarray(_observations()), np.full((ROWS, OBS), 0.2, np.float32)

    def scaled(normaliser, states):
        return (states.astype(np.float64) - normaliser.mean) / normaliser.scale

    action = np.asarray(cloned.actor.mode(jnp.asarray(scaled(cloned.normaliser, observations + offsets), jnp.float32)))
    values = q_values(judge.critics, scaled(other, observations), action)
    found = _harm("min-q", threat, jnp.asarray(observations), offsets)
    np.testing.assert_allclose(found, -values.mean(axis=0), rtol=2e-3, atol=1e-5)


def test_any_policy_can_be_attacked_with_the_critics_of_another_run(trained):
    observations = np.asarray(_observations())
    cloned, _ = _trained(BehaviourCloning(hidden_sizes=(4,)))
    for name in ("min-q", "min-q-std-first-order"):
        shown = AttackedPolicy(cloned, ATTACKS[name], 0.3, jr.key(0), judge=trained[1]).shown(observations)
        assert (shown != observations).any()


def test_a_judge_that_cannot_help_is_refused(trained):
    policy, judge = trained
    with pytest.raises(ConfigError, match="attacker: attack 'random' asks no critics; .*min-q, min-q-std"):
        attacks.threat_model(policy, ATTACKS["random"], judge)
    other = dataclasses.replace(judge, action_high=(1.0, 4.0))
    with pytest.raises(ConfigError, match=r"attacker: its data have action_high \(1.0, 4.0\).*\(1.0, 5.0\)"):
        attacks.threat_model(policy, ATTACKS["min-q"], other)
