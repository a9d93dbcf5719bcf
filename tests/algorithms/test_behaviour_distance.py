"""The behaviour term: its losses in NumPy, its gradient, its fading weight, and what it asks of the rows."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
import pytest

from golden import networks, soft_actor_critic, tiny
from odaf.algorithms.citations import REBRAC, TD3_BC
from odaf.algorithms.ensemble_sac import EnsembleSAC
from odaf.algorithms.terms import BehaviourDistance
from odaf.errors import ConfigError

EXTRAS = ("next_actions", "followed")
TERM = BehaviourDistance(weight=0.4, target_weight=0.3)


def _setting(term):
    learner = EnsembleSAC(**tiny.SMALL, terms=(term,), discount=0.9, value_range="none")
    return learner, tiny.state_of(learner, models=((),)), tiny.batch(extras=EXTRAS)


def _distance(actions, logged) -> np.ndarray:
    return np.square(networks.numbers(actions) - networks.numbers(logged)).sum(axis=1)


def test_the_actor_keeps_its_mode_near_the_logged_action_in_units_of_the_values_it_climbs():
    with tiny.exactly():
        learner, state, batch = _setting(TERM)
        with tiny.recorded() as drawn:
            learner.actor_loss(state.actor.now, state, batch, jr.key(3))
        (noise,) = drawn
        actions, _ = networks.act(state.actor.now, batch.observations, noise)
        size = np.abs(networks.q_values(state.online_critics, batch.observations, actions).min(axis=0)).mean()

        def expected(actor) -> float:  # the size of the values is a constant of the gradient
            bare = soft_actor_critic.actor_loss(actor, state.online_critics, state.log_temperature.now, batch, noise)
            return bare + 0.4 * size * _distance(networks.mode(actor, batch.observations), batch.actions).mean()

        def loss(actor):
            return learner.actor_loss(actor, state, batch, jr.key(3))

        (value, (_, metrics)), gradient = jax.value_and_grad(loss, has_aux=True)(state.actor.now)
        np.testing.assert_allclose(value, expected(state.actor.now), rtol=1e-9)
        tiny.assert_slopes(gradient, expected, state.actor.now)
        distance = _distance(networks.mode(state.actor.now, batch.observations), batch.actions).mean()
        np.testing.assert_allclose(metrics["behaviour/distance"], distance, rtol=1e-9)
        assert float(metrics["behaviour/weight"]) == pytest.approx(0.4)

        def of_critics(critics):
            context = learner._context(state, batch, critics=critics, values=jnp.ones(tiny.ROWS))
            return TERM.actor_loss(context, (), jr.key(0))[0]

        assert tiny.all_zero(jax.grad(of_critics)(state.online_critics)), "gradients reach the actor only"


def test_the_target_loses_the_distance_of_the_next_action_where_one_was_logged():
    with tiny.exactly():
        learner, state, batch = _setting(TERM)
        followed = jnp.asarray(np.arange(tiny.ROWS) % 2, batch.rewards.dtype)  # in rows that go on, too
        batch = eqx.tree_at(lambda rows: rows.extras["followed"], batch, followed)
        bare = EnsembleSAC(**tiny.SMALL, discount=0.9, value_range="none")
        with tiny.recorded() as drawn:
            y = np.asarray(learner.targets(state, batch, jr.key(5)))
        plain = np.asarray(bare.targets(tiny.state_of(bare), batch, jr.key(5)))
        actions, _ = networks.act(state.actor.now, batch.next_observations, drawn[0])
        gap = 0.3 * networks.numbers(batch.extras["followed"]) * _distance(actions, batch.extras["next_actions"])
        alive = 1.0 - networks.numbers(batch.terminated)
        np.testing.assert_allclose(plain - y, 0.9 * alive * gap, rtol=1e-9)
        assert np.any(plain - y > 0.0) and np.any((alive > 0.0) & (networks.numbers(followed) == 0.0))


def test_the_weight_goes_linearly_to_its_last_value():
    term = BehaviourDistance(weight=0.5, final_weight=0.1, decay_updates=4)
    found = [float(term.weight_at(jnp.asarray(step))) for step in (0, 1, 2, 4, 9)]
    np.testing.assert_allclose(found, [0.5, 0.4, 0.3, 0.1, 0.1], rtol=1e-6)
    with tiny.exactly():
        learner, state, batch = _setting(term)
        later = dataclasses.replace(state, step=state.step + 4)
        losses = [learner.actor_loss(s.actor.now, s, batch, jr.key(3))[1][1] for s in (state, later)]
    assert [float(each["behaviour/weight"]) for each in losses] == pytest.approx([0.5, 0.1])


def test_learned_advantages_take_over_after_so_many_updates():
    """Then the actor learns from the critics' rows, and is held to logged actions that these put above its own."""
    with tiny.exactly():
        early, state, batch = _setting(BehaviourDistance(weight=0.4))
        learner = dataclasses.replace(early, advantage_after=3)
        apart = dataclasses.replace(batch, actor=tiny.batch(seed=9, extras=EXTRAS))
        later = dataclasses.replace(state, step=state.step + 3)

        def after(learner, state, batch):
            return jax.jit(learner.update)(state, batch, jr.key(3))

        def same(one, other):
            pairs = zip(jax.tree.leaves(one.actor.now), jax.tree.leaves(other.actor.now), strict=True)
            return all(np.array_equal(a, b) for a, b in pairs)

        before, metrics = after(learner, dataclasses.replace(state, step=state.step + 2), apart)
        assert same(before, after(early, state, apart)[0]) and float(metrics["behaviour/counted"]) == 1.0
        switched, metrics = after(learner, later, apart)
        assert same(switched, after(learner, later, batch)[0]) and not same(switched, before)
        assert 0.0 < float(metrics["behaviour/counted"]) < 1.0

        with tiny.recorded() as drawn:
            loss, (_, metrics) = learner.actor_loss(state.actor.now, later, batch, jr.key(3))
        actions, _ = networks.act(state.actor.now, batch.observations, drawn[0])
        own, logged = (
            networks.q_values(state.online_critics, batch.observations, each).min(axis=0)
            for each in (actions, batch.actions)
        )
        counted = logged > own
        distances = _distance(networks.mode(state.actor.now, batch.observations), batch.actions)
        bare = soft_actor_critic.actor_loss(
            state.actor.now, state.online_critics, state.log_temperature.now, batch, drawn[0]
        )
        expected = bare + 0.4 * np.abs(own).mean() * (counted * distances).mean()
        np.testing.assert_allclose(loss, expected, rtol=1e-9)
        np.testing.assert_allclose(metrics["behaviour/counted"], counted.mean())


@pytest.mark.parametrize(("updates", "terms"), [(-1, (TERM,)), (5, ()), (5, (BehaviourDistance(weight=0.0),))])
def test_learned_advantages_need_a_behaviour_term(updates, terms):
    with pytest.raises(ConfigError, match="advantage_after"):
        EnsembleSAC(advantage_after=updates, terms=terms)


def test_only_the_targets_part_asks_for_the_next_logged_actions():
    both, alone = (EnsembleSAC(terms=(BehaviourDistance(target_weight=weight),)) for weight in (0.1, 0.0))
    assert both.view().extras == EXTRAS and alone.view().extras == ()
    assert EnsembleSAC(terms=(BehaviourDistance(weight=0.0, target_weight=0.1),)).view().extras == ()
    assert TERM.citations() == (TD3_BC, REBRAC) and BehaviourDistance().citations() == (TD3_BC,)


@pytest.mark.parametrize(
    "fields",
    [
        {"weight": -0.1},
        {"target_weight": -0.1},
        {"final_weight": -0.1, "decay_updates": 5},
        {"decay_updates": 5},
        {"decay_updates": -1},
        {"final_weight": 0.1},
    ],
)
def test_nonsense_is_refused(fields):
    with pytest.raises(ConfigError, match="behaviour"):
        BehaviourDistance(**fields)
