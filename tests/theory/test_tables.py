"""The tabular theory against values worked by hand, and against definitions written out."""

import itertools

import numpy as np
import pytest

from odaf.theory import bound, concentrability
from odaf.theory.candidates import action_supported, leak, outcome_supported
from odaf.theory.empirical import draw_logs
from odaf.theory.equivalence import penalty, unseen_mass
from odaf.theory.gridworld import Grid, logged_moves, snake, walk
from odaf.theory.mdp import TabularMDP, policy_values, random_mdp, random_support, state_distribution, uniform_policy
from odaf.theory.operator import backup, fixed_point, greedy, iterate, state_values


def two_states() -> TabularMDP:
    """From 0, action 0 stays and pays 1, action 1 goes to 1 for nothing; state 1 stays and pays 3, or 0 by action 1."""
    transitions = np.array([[[1.0, 0.0], [0.0, 1.0]], [[0.0, 1.0], [0.0, 1.0]]])
    return TabularMDP(transitions, np.array([[1.0, 0.0], [3.0, 0.0]]), 0.5)


BOTH = np.ones((2, 2), bool)


def test_values_by_hand():
    mdp = two_states()
    # Staying in 1 is worth 3 / (1 - 0.5) = 6, going there 0.5 * 6 = 3, staying in 0 for good 2, once more 1 + 0.5 * 3.
    np.testing.assert_allclose(fixed_point(mdp, BOTH), [[2.5, 3.0], [6.0, 3.0]], atol=1e-9)
    assert mdp.largest_value == 6.0
    stays = np.array([[True, False], [True, True]])
    np.testing.assert_allclose(fixed_point(mdp, stays), [[2.0, 3.0], [6.0, 3.0]], atol=1e-9)
    assert greedy(fixed_point(mdp, stays), stays).tolist() == [0, 0] and greedy(fixed_point(mdp, BOTH), BOTH)[0] == 1
    np.testing.assert_allclose(policy_values(mdp, np.array([[0, 0], [1, 0], [1, 1]])), [[2, 6], [3, 6], [0, 0]])
    # Leaving at once: d(0) = (1 - gamma) = 0.5.
    np.testing.assert_allclose(state_distribution(mdp, np.eye(2)[[1, 0]], np.array([1.0, 0.0])), [0.5, 0.5])
    # Uniform, it stays with odds 1/2: d(0) = 0.5 (1 + 1/4 + 1/16 + ...) = 2/3.
    np.testing.assert_allclose(state_distribution(mdp, uniform_policy(mdp), np.array([1.0, 0.0])), [2 / 3, 1 / 3])


def test_the_operator_is_its_formula_and_its_fixed_point_the_best_policy_of_the_set():
    rng = np.random.default_rng(0)
    mdp = random_mdp(rng, states=4, actions=3, concentration=0.5)
    allowed = outcome_supported(mdp.transitions, np.array([True, True, True, False]))
    q = rng.normal(size=(2, 4, 3))
    expected = np.empty_like(q)
    for draw, s, a in itertools.product(range(2), range(4), range(3)):
        best = [max(q[draw, z, b] for b in range(3) if allowed[z, b]) for z in range(4)]
        expected[draw, s, a] = mdp.rewards[s, a] + 0.9 * sum(mdp.transitions[s, a, z] * best[z] for z in range(4))
    np.testing.assert_allclose(backup(q, mdp, allowed), expected, atol=1e-12)
    np.testing.assert_allclose(iterate(q, mdp, allowed, 2), backup(expected, mdp, allowed), atol=1e-12)
    # All deterministic policies of the set, evaluated: the largest value of each state is that of the fixed point.
    choices = itertools.product(*(np.flatnonzero(row) for row in allowed))
    values = policy_values(mdp, np.array(list(choices)))
    np.testing.assert_allclose(state_values(fixed_point(mdp, allowed), allowed), values.max(0), atol=1e-8)


def test_candidates_are_the_policies_whose_outcomes_stay_in_the_support():
    transitions = np.zeros((3, 2, 3))
    transitions[0] = [[0.5, 0.5, 0.0], [0.9, 0.0, 0.1]]
    transitions[1] = [[0.0, 0.7, 0.3], [0.2, 0.6, 0.2]]
    transitions[2] = [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]
    support = np.array([True, True, False])
    np.testing.assert_allclose(leak(transitions, support), [[0, 0.1], [0.3, 0.2], [1, 0]])
    # State 1 has none that stays; the second leaks less.
    expected = [[True, False], [False, True], [False, True]]
    assert outcome_supported(transitions, support).tolist() == expected
    logged = np.array([[True, True], [True, False], [False, False]])
    assert action_supported(logged, transitions, support).tolist() == [[True, True], [True, False], [False, True]]


def test_a_policy_is_in_the_set_exactly_if_each_of_its_actions_is():
    rng = np.random.default_rng(1)
    mdp = random_mdp(rng)
    support = random_support(rng, 20, 0.8)
    assert support.sum() == 16
    allowed = leak(mdp.transitions, support) == 0.0
    for state in range(20):
        taken = rng.uniform(size=4) < 0.5
        taken[rng.integers(4)] = True
        outcomes = (taken / taken.sum()) @ mdp.transitions[state]
        assert (outcomes[~support].sum() == 0.0) == allowed[state, taken].all()


def test_random_problems_have_exact_zeros():
    mdp = random_mdp(np.random.default_rng(2))
    np.testing.assert_allclose(mdp.transitions.sum(-1), 1.0)
    assert (mdp.transitions == 0.0).mean() > 0.5 and mdp.transitions[mdp.transitions > 0].min() >= 0.01
    assert mdp.rewards.min() >= 0.0 and mdp.rewards.max() <= 1.0


def test_logs_show_what_was_drawn():
    mdp = two_states()
    pairs = np.array([[0.5, 0.25], [0.25, 0.0]])
    logs = draw_logs(np.random.default_rng(0), mdp, pairs, 4_000, 3)
    assert (logs.counts.sum((1, 2)) == 4_000).all() and (logs.counts[:, 1, 1] == 0).all()
    np.testing.assert_allclose(logs.counts / 4_000, np.broadcast_to(pairs, (3, 2, 2)), atol=0.04)
    np.testing.assert_allclose(logs.mdp.transitions[:, 0], np.broadcast_to(mdp.transitions[0], (3, 2, 2)))
    assert (logs.mdp.transitions[:, 1, 1] == 0.5).all()  # no rows: uniform
    half = TabularMDP(np.full((2, 2, 2), 0.5), mdp.rewards, 0.5)
    shares = draw_logs(np.random.default_rng(0), half, pairs, 40_000, 1).mdp.transitions[0, 0]
    assert 0.0 < np.abs(shares - 0.5).max() < 0.02


def test_bounds_by_hand():
    # log(2 * 2 * 2^2 / 0.1) = log 160 = 5.0752; with 100 rows sqrt(0.101504) = 0.31860, with 1 row 3.19, so 2.
    np.testing.assert_allclose(bound.l1_radius(np.array([0, 1, 100]), 2, 4, 0.1), [2, 2, 0.318597], atol=1e-5)
    mdp, counts = two_states(), np.array([[[100, 200], [400, 300]], [[100, 200], [0, 300]]])
    # gamma V_max / (1 - gamma) = 0.5 * 6 / 0.5 = 6 times the radius of the rarest pair.
    np.testing.assert_allclose(bound.error_bound(counts, mdp, 0.1), [6 * 0.318597, 12.0], atol=1e-4)
    pairs = np.array([[0.1, 0.4], [0.4, 0.1]])
    # gamma R_max / (1 - gamma) = 3; with 1,000 rows 100 or 400 of a pair, of which the radius is half.
    np.testing.assert_allclose(
        bound.printed_bound(1_000, pairs, mdp, 0.1), 3 * 0.318597 * np.array([[1, 0.5], [0.5, 1]]), atol=1e-4
    )
    assert bound.printed_bound(1_000, pairs, mdp, 0.1, 6.0)[0, 0] == pytest.approx(6 * 0.318597, abs=1e-4)
    assert bound.iteration_error(3, np.full((1, 2, 2), 5.0), np.array([[5.0, 1.0], [5.0, 6.0]]), 0.5) == 4 / 8


def test_errors_add_up_along_what_follows():
    mdp = two_states()
    local = np.array([[[0.0, 1.0], [2.0, 0.0]]])
    # Going from 0 to 1 errs by 1, then by 2 a step for good: 1 + 0.5 * 4 = 3. Staying once, then going: 0.5 * 3.
    learned = TabularMDP(mdp.transitions[None], mdp.rewards, 0.5)
    np.testing.assert_allclose(bound.propagated_errors(local, learned, BOTH), [[[1.5, 3.0], [4.0, 2.0]]], atol=1e-9)
    off = mdp.transitions.copy()
    off[0, 1] = [0.5, 0.5]
    found = bound.local_errors(fixed_point(mdp, BOTH), mdp, TabularMDP(off[None], mdp.rewards, 0.5), BOTH)
    np.testing.assert_allclose(found, [[[0.0, 0.5 * (6.0 - 4.5)], [0.0, 0.0]]], atol=1e-9)


def test_the_smallest_ratio_over_all_policies_is_found():
    outcomes, distribution = np.array([[0.9, 0.1, 0.0], [0.2, 0.2, 0.6]]), np.array([0.5, 0.2, 0.3])
    mixed = [(p * outcomes[0] + (1 - p) * outcomes[1]) / distribution for p in np.linspace(0.0, 1.0, 10_001)]
    assert concentrability.smallest_supremum(outcomes, distribution) == pytest.approx(
        min(ratios.max() for ratios in mixed), abs=1e-3
    )
    assert concentrability.smallest_supremum(distribution[None], distribution) == pytest.approx(1.0)
    assert concentrability.constant(np.broadcast_to(outcomes, (3, 2, 3)), distribution) == pytest.approx(2.0)


def test_outcomes_of_several_steps():
    rng = np.random.default_rng(3)
    mdp = random_mdp(rng, states=3, actions=2)
    policies = [concentrability.random_policy(rng, np.ones((3, 2), bool)) for _ in range(2)]
    first, second, third = concentrability.outcomes_of_steps(mdp, policies)
    assert first is mdp.transitions
    by_hand = np.zeros((3, 2, 3))
    for s, a, z, b, y in itertools.product(range(3), range(2), range(3), range(2), range(3)):
        by_hand[s, a, y] += mdp.transitions[s, a, z] * policies[0][z, b] * mdp.transitions[z, b, y]
    np.testing.assert_allclose(second, by_hand, atol=1e-12)
    np.testing.assert_allclose(third.sum(-1), 1.0)
    only = np.array([[True, False], [False, True], [True, True]])
    policy = concentrability.random_policy(rng, only)
    assert (policy[~only] == 0.0).all() and np.allclose(policy.sum(-1), 1.0)
    # 0.5^2 * C * (0.25 * 2 + 0.75 * 3), the 9 is of an action outside the set.
    difference, allowed = np.array([[2.0, -9.0], [1.0, -3.0]]), np.array([[True, False], [True, True]])
    assert concentrability.iteration_error(2, difference, allowed, np.array([0.25, 0.75]), 4.0, 0.5) == 2.75


def test_penalty_and_unseen_mass_by_hand():
    outcomes = np.array([[0.5, 0.3, 0.2], [0.0, 0.1, 0.9]])
    policies = np.array([[[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]], [[1.0, 0.0], [1.0, 0.0], [0.5, 0.5]]])
    uncertainty = np.array([[0.1, 9.0], [0.2, 0.4], [1.0, 3.0]])
    # 0.5 * 0.1 + 0.3 * 0.3 + 0.2 * 3, and 0.1 * 0.2 + 0.9 * 2.
    np.testing.assert_allclose(penalty(outcomes, policies, uncertainty), [0.74, 1.82])
    np.testing.assert_allclose(unseen_mass(outcomes, np.array([True, False, False])), [0.5, 1.0])


def test_moves_on_a_grid():
    grid = Grid(("S.#", ".XG"))
    assert grid.cells == [(0, 0), (0, 1), (1, 0), (1, 1), (1, 2)]
    # North, east, south, west; walls and edges keep, trap and goal too.
    assert grid.successors().tolist() == [[0, 1, 2, 0], [1, 1, 3, 0], [0, 3, 2, 2], [3, 3, 3, 3], [4, 4, 4, 4]]
    mdp = grid.mdp(0.9, trap_reward=0.5)
    assert mdp.rewards[1].tolist() == [0, 0, 0.5, 0] and mdp.rewards[2].tolist() == [0, 0.5, 0, 0]
    assert not mdp.rewards[[0, 3, 4]].any() and mdp.transitions[2, 1, 3] == 1.0
    assert walk(grid, np.array([1, 3, 0, 0, 0])) == [(0, 0), (0, 1)]
    logged, visited = logged_moves(grid, [(0, 1), (0, 0), (1, 0)])
    assert np.argwhere(logged).tolist() == [[0, 2], [1, 3]] and visited.tolist() == [True, True, True, False, False]
    assert snake(3, 2) == [(0, 0), (0, 1), (1, 1), (1, 0), (2, 0), (2, 1)]
