"""A policy with a guard: it acts, says when it is out of its depth and why, and does then what it was told to do."""

import dataclasses
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray, PyTree

from odaf.components.policies import Actor
from odaf.data.normalisation import scale_actions, unscale_actions
from odaf.deployment.conformal import Calibration
from odaf.deployment.guard_file import read_guard, write_guard
from odaf.deployment.score import MISSING, NO_COLUMN, PARTS, GuardScore, Judgement
from odaf.errors import ConfigError, DatasetError
from odaf.report.plain_tables import table
from odaf.training.policy import Carry, Observation, Policy

Reaction = Literal["warn", "hold", "clone", "stop"]
REACTIONS: dict[str, str] = {
    "warn": "the policy's own action is given all the same",
    "hold": "the last action is held",
    "clone": "what whoever wrote the log would have done is done",
    "stop": "no action is given any more, until a new episode begins",
}


class GuardCarry(NamedTuple):
    """What a guarded policy carries from step to step; every array has a leading axis of rows.

    Attributes:
        alarm: [rows] bool, whether the last step was an alarm.
        stopped: [rows] bool, whether an alarm has stopped it; only with the reaction "stop".
        score: [rows] float32, of the last step; NaN where a reading was no finite number, or nothing could be judged.
        part: [rows] int, the part of `odaf.deployment.score.PARTS` that the score is due to, `MISSING` for a reading.
        column: [rows] int, the column that the part owes most to: of observations and then actions, or of the readings
            where one is missing; -1 for none.
        policy: the policy's own carry.
        readings: [rows, readings], the last finite ones, NaN where there was none yet.
        state: [rows, obs_dim], normalised; NaN where it is not known.
        action: [rows, act_dim], what was done last, in the log's units; NaN where nothing was.
    """

    alarm: np.ndarray
    stopped: np.ndarray
    score: np.ndarray
    part: np.ndarray
    column: np.ndarray
    policy: PyTree
    readings: np.ndarray
    state: np.ndarray
    action: np.ndarray


@dataclass(frozen=True, eq=False)
class GuardedPolicy:
    """A policy, the score of what it is about to do, and the threshold of an alarm.

    It is played with `begin` and `act`, one step after another, since the score compares what is seen with what the
    step before should have led to. Rewards are told with `observe`, what was played in the place of its action with
    `acted`.

    Attributes:
        policy: what acts; its actor has no memory, its observations may be computed of readings.
        score: what is judged, and how.
        calibration: the threshold, and how often a sound episode goes above it.
        reaction: what is done in a step with an alarm; see `REACTIONS`. In a step whose readings are not all finite
            numbers no network has an answer, so that "warn" and "clone" hold the last action too.
        clone: what imitates whoever wrote the log, on normalised observations; None without the reaction "clone".
        facts: how it was made, as plain JSON types.
    """

    policy: Policy
    score: GuardScore
    calibration: Calibration
    reaction: Reaction
    clone: Actor | None
    facts: Mapping[str, Any]

    def __post_init__(self):
        if self.reaction not in REACTIONS:
            raise ConfigError(f"reaction={self.reaction!r} is none of {', '.join(REACTIONS)}")
        if self.reaction == "clone" and self.clone is None:
            raise ConfigError('reaction="clone": no clone was fitted; make the guard with that reaction')

    # ---- acting -------------------------------------------------------------------------------------------------

    def begin(self, rows: int = 1) -> GuardCarry:
        """The carry before the first step of `rows` episodes that go side by side."""
        widths = len(self.policy.reading_names), self.policy.obs_dim, self.policy.act_dim
        readings, state, action = (np.full((rows, width), np.nan, np.float32) for width in widths)
        nothing = np.zeros(rows, bool)
        return GuardCarry(
            nothing,
            nothing,
            np.full(rows, np.nan, np.float32),
            np.full(rows, MISSING),
            np.full(rows, NO_COLUMN),
            self.policy.begin(rows),
            readings.astype(np.float64) if self.policy.derivation is not None else readings,
            state,
            action,
        )

    def act(
        self, carry: GuardCarry, observation: Observation, key: int | PRNGKeyArray | None = None
    ) -> tuple[np.ndarray, GuardCarry]:
        """One step.

        Args:
            carry: of `begin` or of the last step.
            observation: as for `odaf.Policy.act`, but that readings may be NaN or infinite: that is an alarm.
            key: as for `odaf.Policy.act`.

        Returns:
            Actions as of `odaf.Policy.act`, and the next carry, which says whether this step was an alarm. NaN where
            it is stopped, where a reading is missing before anything was done, and in the first steps of a policy whose
            observations are made of earlier ones: there somebody else has to act.

        Raises:
            DatasetError, DivergenceError: as `odaf.Policy.act`, values that are not finite apart.
        """
        given = self.policy.rows_of(observation)
        readings = given[None] if given.ndim == 1 else given
        missing = ~np.isfinite(readings)
        blind = np.any(missing, axis=1)
        filled = np.where(missing, np.where(np.isnan(carry.readings), 0.0, carry.readings), readings)
        filled = filled.astype(readings.dtype)
        # A missing reading counts as the last one for what is remembered, so that the next step has its history.
        rows, actions, after = self._asked(carry.policy, filled, key)
        known = np.asarray(~blind & ~np.any(np.isnan(rows), axis=1))

        scaled = self._scaled(np.where(known[:, None], actions, 0.0))
        before = carry.state, self._scaled(carry.action)
        found = judged(self.score, self.policy.actor, np.where(known[:, None], rows, 0.0), scaled, before)
        score = np.where(known, np.asarray(found.score), np.nan)
        alarm = blind | (known & ~(score <= self.calibration.threshold)) | carry.stopped
        stopped = alarm if self.reaction == "stop" else carry.stopped
        taken = self._reacted(actions, carry.action, np.asarray(found.state), alarm, known)
        taken = np.where((blind & ~known)[:, None], carry.action, taken)
        taken[stopped] = np.nan
        if self.policy.derivation is not None and self.policy.derivation.lags:
            remembered = np.where(stopped[:, None], actions, taken)
            after = self.policy.acted(after, remembered) if np.isfinite(remembered).all() else after
        state = np.where(known[:, None], np.asarray(found.state), np.nan)
        carry = GuardCarry(
            alarm,
            stopped,
            score.astype(np.float32),
            np.where(blind, MISSING, np.asarray(found.part)),
            np.where(blind, missing.argmax(axis=1), np.asarray(found.column)),
            after,
            np.where(missing, carry.readings, readings),
            state.astype(np.float32),
            taken.astype(np.float32),
        )
        return (carry.action[0] if given.ndim == 1 else carry.action), carry

    def acted(self, carry: GuardCarry, actions: Observation) -> GuardCarry:
        """The carry after a step in which something else was played than `act` gave; as `odaf.Policy.acted`."""
        if isinstance(actions, Mapping):
            names = self.columns[self.policy.obs_dim :]
            if set(actions) != set(names):
                raise DatasetError(f"action: {sorted(actions)} are not its columns; give exactly {', '.join(names)}")
            actions = np.array([actions[name] for name in names], np.float32)
        played = np.asarray(actions, np.float32).reshape(carry.action.shape)
        return carry._replace(policy=self.policy.acted(carry.policy, played), action=played)

    def observe(self, carry: GuardCarry, rewards: np.ndarray) -> GuardCarry:
        """The carry after the rewards of the last actions; no guarded policy remembers them."""
        del rewards
        return carry

    def said(self, carry: GuardCarry) -> tuple[str, ...]:
        """For each row what the last step's alarm was about, in words; an empty text where there was none."""
        found = []
        for row in range(len(carry.alarm)):
            part, column = int(carry.part[row]), int(carry.column[row])
            if not carry.alarm[row]:
                found.append("")
            elif part == MISSING:
                found.append(f"reading '{self.policy.reading_names[column]}' is no finite number")
            else:
                owed = "" if column == NO_COLUMN else f", mostly '{self.columns[column]}'"
                size = carry.score[row] / self.calibration.threshold
                found.append(f"{PARTS[part]} is {size:.3g} times its limit{owed}")
        return tuple(found)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of observations and then actions."""
        names = self.policy.action_names or tuple(f"action {index}" for index in range(self.policy.act_dim))
        return (*self.policy.observation_names, *names)

    # ---- files --------------------------------------------------------------------------------------------------

    def save(self, file: str | os.PathLike[str]) -> None:
        """Writes policy and guard to one file in the layout of safetensors, whole or not at all.

        Raises:
            CheckpointError: the file cannot be written.
            ConfigError: a network is of a class that is not registered in `odaf.components.stored.KINDS`.
        """
        write_guard(Path(file), {**vars(self), "policy": vars(self.policy)})

    @classmethod
    def load(cls, file: str | os.PathLike[str]) -> "GuardedPolicy":
        """Inverse of `save`; never runs code of the file.

        Raises:
            CheckpointError: the file is missing, damaged, or holds something else.
        """
        fields = read_guard(Path(file))
        return cls(**{**fields, "policy": Policy(**fields["policy"])})

    # ---- what it rests on ---------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types: the calibration, the parts' levels, and how it was made."""
        levels = dict(zip(PARTS, np.asarray(self.score.levels).tolist(), strict=True))
        calibration = dataclasses.asdict(self.calibration)
        return {"calibration": calibration, "levels": levels, "reaction": self.reaction, **self.facts}

    def __str__(self) -> str:
        calibration, facts = self.calibration, self.facts
        rows = [
            [part, f"{level:.4g}", f"{level * calibration.threshold:.4g}", f"{facts['alarms_by_part'][part]:,}"]
            for part, level in zip(PARTS, np.asarray(self.score.levels).tolist(), strict=True)
        ]
        kind = "recordings" if calibration.episode_steps is None else f"pieces of {calibration.episode_steps:,} rows"
        lines = [
            table(["part of the score", "level", "limit", "episodes above"], rows),
            "",
            f"False alarms: in at most {calibration.promised:.2%} of episodes like the {calibration.episodes:,} set "
            f"aside ({kind}, {calibration.median_length:,} steps at the median), asked for "
            f"{calibration.false_alarms:.2%}; of these, {facts['alarms']:,} lie above the threshold.",
            f"With the policy's own actions in the same states, {facts['policy_alarms']:,} of "
            f"{calibration.episodes:,} would have an alarm.",
            f"On an alarm, {REACTIONS[self.reaction]}.",
            f"Critics: {facts['critics']}. Dynamics: {facts['dynamics']}.",
        ]
        return "\n".join([*lines, *(f"note: {note}" for note in facts["notes"])])

    # ---- inside -------------------------------------------------------------------------------------------------

    def _asked(
        self, carry: PyTree, readings: np.ndarray, key: int | PRNGKeyArray | None
    ) -> tuple[np.ndarray, np.ndarray, PyTree]:
        """Observations [rows, obs_dim], the policy's actions, and its next carry."""
        derivation = self.policy.derivation
        if derivation is None:
            return readings, *self.policy.act(carry, readings, key)
        memory = carry.memory if isinstance(carry, Carry) else derivation.begin(len(readings))
        observations, _ = derivation.step(readings, memory)
        return observations, *self.policy.act(carry, readings, key)

    def _scaled(self, actions: np.ndarray) -> np.ndarray:
        return np.asarray(scale_actions(actions, self.policy.action_low, self.policy.action_high), np.float32)

    def _reacted(
        self, actions: np.ndarray, last: np.ndarray, states: np.ndarray, alarm: np.ndarray, known: np.ndarray
    ) -> np.ndarray:
        """What is done; with nothing to hold, the policy's own action."""
        instead = actions
        if self.reaction == "hold":
            instead = np.where(np.isnan(last), actions, last)
        elif self.reaction == "clone" and (alarm & known).any():
            assert self.clone is not None
            imitated = unscale_actions(
                np.asarray(_mode(self.clone, states)), self.policy.action_low, self.policy.action_high
            )
            instead = np.clip(imitated, self.policy.action_low, self.policy.action_high)
        return np.array(np.where(alarm[:, None], instead, actions), np.float32)


def judged(
    score: GuardScore,
    actor: Actor,
    observations: np.ndarray,
    actions: np.ndarray,
    before: tuple[np.ndarray, np.ndarray],
) -> Judgement:
    """`GuardScore.judge`, compiled once for a kind of guard and a number of rows."""
    columns = (np.asarray(column, np.float32) for column in (observations, actions, *before))
    seen, taken, state, action = map(jnp.asarray, columns)
    return _judge(score, actor, seen, taken, (state, action))


@eqx.filter_jit
def _judge(
    score: GuardScore,
    actor: Actor,
    observations: Float[Array, "rows obs_dim"],
    actions: Float[Array, "rows act_dim"],
    before: tuple[Float[Array, "rows obs_dim"], Float[Array, "rows act_dim"]],
) -> Judgement:
    return score.judge(actor, observations, actions, before)


@jax.jit
def _mode(actor: Actor, states: Float[Array, "rows obs_dim"]) -> Float[Array, "rows act_dim"]:
    return actor.mode(states)
