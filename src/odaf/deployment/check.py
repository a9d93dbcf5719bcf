"""Whether every form of an artefact does what the policy does: run in its own runtime, on inputs of all kinds.

Two forms agree where their actions differ by no more than 1e-5 of half the range between the bounds. Far outside of the
log, and where two candidates are worth the same, single precision itself does not tell an action to 1e-5: a sum taken
in another order gives another one. There a form may be off by what rounding explains, which is measured: the program is
run in double precision, once as it is and several times with each sum and function moved at random by what single
precision rounds away.
"""

import json
import os
import shutil
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from odaf.deployment import odaf_policy
from odaf.deployment.c_text import DRIVER
from odaf.deployment.guard import GuardedPolicy
from odaf.deployment.odaf_policy import ALARM, FINE, NOT_FINITE, NOT_KNOWN, STOPPED
from odaf.deployment.onnx_form import imported
from odaf.deployment.policies import action_names
from odaf.deployment.program import STATUS
from odaf.errors import ConfigError
from odaf.training.policy import Policy

TOLERANCE = 1e-5  # of half an action's range
NEAR = 1e-3  # of a threshold: scores in which another order of a sum may decide about an alarm
_EPISODES, _STEPS = 40, 8  # of policies with a memory; others see so many single steps
_ROUNDING_RUNS = (8, 128)
_MARGIN = 0.2
_UNIT = 4.0 * 2.0**-24  # a few times half a unit in the last place
_LARGEST = 1e30


@dataclass(frozen=True)
class Trials:
    """Episodes to run.

    Attributes:
        observations: [episodes, steps, columns] float32, as the forms take them: the last reward among them, if asked.
        played: [episodes, steps, act_dim] float32, what somebody else played; NaN where the action itself was.
    """

    observations: np.ndarray
    played: np.ndarray

    def part(self, episodes: Any, steps: int) -> "Trials":
        """Some episodes, and so many of their first steps."""
        return Trials(self.observations[episodes, :steps], self.played[episodes, :steps])


Found = tuple[np.ndarray, np.ndarray]  # actions [episodes, steps, act_dim], and status [episodes, steps]
Runner = Callable[[Trials], Found]
Rounding = Callable[..., np.ndarray]
"""[act_dim] by how much single precision may move the action in the last step of one episode: of trials, and how often
to run the program."""


@dataclass(frozen=True)
class Agreement:
    """How one form compares with the policy.

    Attributes:
        largest_difference: of half an action's range, where single precision tells the action.
        steps: that were compared.
        left_to_rounding: steps of these where it does not, and the form is as near as it can be.
    """

    largest_difference: float
    steps: int
    left_to_rounding: int
    close: np.ndarray  # [episodes] whether the form is far within the tolerance at every step

    def to_dict(self) -> dict[str, Any]:
        """The figures, in JSON types."""
        return {name: value for name, value in vars(self).items() if name != "close"}


def make_trials(policy: Policy, ranges: Mapping[str, Any] | None, remembers: bool, seed: int = 0) -> Trials:
    """Random, extreme and boundary inputs: near the log, on the edges of what it showed, and up to a million standard
    deviations away.

    Args:
        policy: in the user's units.
        ranges: of the log, as `odaf.data.ranges` gives them; None where they are not known.
        remembers: whether an action depends on the steps before.
        seed: of what is random.
    """
    rng = np.random.default_rng(seed)
    columns = [policy.observation_names.index(name) for name in policy.reading_names]
    mean = policy.normaliser.mean[columns].astype(np.float64)
    std = policy.normaliser.std[columns].astype(np.float64)
    std = np.where(std > 0.0, std, np.maximum(np.abs(mean), 1.0))  # a column that never varied is varied here
    low, high = mean - 3.0 * std, mean + 3.0 * std
    if ranges is not None:
        low, high = (np.asarray(ranges[f"observation_{end}"], np.float64)[columns] for end in ("low", "high"))
    steps = policy.history + _STEPS if remembers else 1
    shape = (_EPISODES if remembers else _EPISODES * _STEPS, steps, len(columns))
    near = mean + std * rng.standard_normal(shape)
    edges = np.where(rng.random(shape) < 0.5, low, high)
    on_edges = np.where(rng.random(shape) < 0.3, edges, np.clip(near, low, high))
    size = 10.0 ** rng.uniform(1.0, 6.0, (*shape[:2], 1))
    far = mean + std * size * rng.standard_normal(shape)
    kind = rng.choice(4, (*shape[:2], 1), p=[0.4, 0.2, 0.2, 0.2])
    observations = np.choose(kind, [near, edges, on_edges, far])
    observations[0, 0], observations[1, 0] = mean, 0.0
    played = np.full((*shape[:2], policy.act_dim), np.nan)
    played[:, : policy.history] = rng.uniform(
        policy.action_low, policy.action_high, (shape[0], min(policy.history, steps), policy.act_dim)
    )
    if policy.actor.takes_rewards:
        rewards = 10.0 ** rng.uniform(-2.0, 2.0, (*shape[:2], 1)) * rng.standard_normal((*shape[:2], 1))
        observations = np.concatenate([observations, rewards], axis=2)
    return Trials(np.clip(observations, -_LARGEST, _LARGEST).astype(np.float32), played.astype(np.float32))


def expected(policy: Policy, trials: Trials, max_change: Mapping[str, float]) -> Found:
    """What the policy does, and the limits make of it.

    Raises:
        DivergenceError: it acts with numbers that are not finite.
    """
    low, high = np.asarray(policy.action_low), np.asarray(policy.action_high)
    names = action_names(policy)
    change = np.array([max_change.get(name, np.inf) for name in names])
    episodes, steps, _ = trials.observations.shape
    carry, last = policy.begin(episodes), np.full((episodes, policy.act_dim), np.nan)
    actions = np.empty_like(trials.played)
    with jax.default_matmul_precision("highest"):
        for step in range(steps):
            given = trials.observations[:, step]
            if policy.actor.takes_rewards:
                given, rewards = given[:, :-1], given[:, -1]
                carry = policy.observe(carry, rewards)
            found, carry = policy.act(carry, given)
            if max_change:
                limited = np.clip(np.clip(found.astype(np.float64), last - change, last + change), low, high)
                found = np.where(np.isnan(last), found, limited).astype(np.float32)
            actions[:, step] = found
            played = trials.played[:, step]
            last = np.where(np.isnan(played), found, played).astype(np.float64)
            carry = policy.acted(carry, last)
    return actions, np.where(np.isnan(actions).any(axis=2), NOT_KNOWN, FINE)


def guarded_trials(guarded: GuardedPolicy, trials: Trials) -> tuple[Trials, Found]:
    """What a guarded policy does, in those of the trials in which no score lies on the threshold to single precision.

    Raises:
        DivergenceError: it acts with numbers that are not finite.
    """
    episodes, steps, _ = trials.observations.shape
    carry, threshold = guarded.begin(episodes), guarded.calibration.threshold
    actions, status = np.empty_like(trials.played), np.empty((episodes, steps), int)
    clear = np.ones(episodes, bool)
    with jax.default_matmul_precision("highest"):
        for step in range(steps):
            actions[:, step], carry = guarded.act(carry, trials.observations[:, step])
            status[:, step] = np.where(carry.alarm, ALARM, FINE)
            status[:, step][np.isnan(actions[:, step]).any(axis=1)] = NOT_KNOWN
            status[:, step][carry.stopped] = STOPPED
            clear &= ~(np.abs(carry.score / threshold - 1.0) < NEAR)
            played = trials.played[:, step]
            carry = guarded.acted(carry, np.where(np.isnan(played), np.nan_to_num(actions[:, step]), played))
    return trials.part(clear, steps), (actions[clear], status[clear])


def compare(form: str, runner: Runner, policy: Policy, trials: Trials, wanted: Found, rounding: Rounding) -> Agreement:
    """How a form compares on the trials, and that it refuses what is not finite.

    Args:
        form: the file's name, for messages.
        runner: runs it.
        policy: whose form it is.
        trials: what to run.
        wanted: what `expected` gave for them.
        rounding: of the program.

    Raises:
        ConfigError: the form does something else.
    """
    half = (np.asarray(policy.action_high) - np.asarray(policy.action_low)) / 2.0
    actions, status = runner(trials)
    largest, compared, left, told, close = 0.0, 0, 0, True, np.ones(len(status), bool)
    for episode, step in np.ndindex(*status.shape):
        told = told or step == 0
        if not told:
            continue  # what the form remembers is no longer what the policy did
        until = trials.part(slice(episode, episode + 1), step + 1)
        if status[episode, step] != wanted[1][episode, step]:
            either = {status[episode, step], wanted[1][episode, step]} == {FINE, ALARM}
            if either and not (rounding(until, _ROUNDING_RUNS[-1]) <= TOLERANCE * half).all():
                left, told = left + 1, False  # a guard judges one of two candidates that are worth the same
                continue
            _refuse(
                form, f"gives status {status[episode, step]} in place of {wanted[1][episode, step]}", trials, episode
            )
        if status[episode, step] not in (FINE, ALARM):
            continue
        compared += 1
        off = np.abs(actions[episode, step].astype(np.float64) - wanted[0][episode, step])
        close[episode] &= bool((off <= _MARGIN * TOLERANCE * half).all())
        if (off <= TOLERANCE * half).all():
            largest = max(largest, float((off / half).max()))
            continue
        allowed = half
        for runs in _ROUNDING_RUNS:  # where two candidates are worth the same, not every run takes the other one
            allowed = TOLERANCE * half + rounding(until, runs)
            if (off <= allowed).all():
                break
        else:
            worst = int(np.argmax(off / allowed))
            _refuse(
                form,
                f"gives {action_names(policy)[worst]} = {actions[episode, step, worst]:.9g} where the policy gives "
                f"{wanted[0][episode, step, worst]:.9g}",
                trials,
                episode,
            )
        left, told = left + 1, False
    _check_refusals(form, runner, trials)
    return Agreement(largest, compared, left, close)


def measured_rounding(file: Path, seed: int = 0) -> Rounding:
    """Measures rounding in the program of a file of the NumPy form."""

    exact, moved = (odaf_policy.Policy(file, np.float64) for _ in range(2))
    rng, kinds = np.random.default_rng(seed), {function: kind for kind, function in odaf_policy.OPERATIONS.items()}
    moved.steps = [
        (_moved(kinds[function], function, rng), result, arguments, attributes)
        for function, result, arguments, attributes in moved.steps
    ]

    def measure(trials: Trials, runs: int = _ROUNDING_RUNS[0]) -> np.ndarray:
        found = np.array([_last_action(policy, trials) for policy in (exact, *[moved] * runs)])
        off = np.abs(found[1:] - found[0])
        return 2.0 * np.where(np.isnan(off), np.inf, off).max(axis=0)

    return measure


def numpy_runner(file: Path) -> Runner:
    """Runs the NumPy form."""
    policy = odaf_policy.Policy(file)

    def run(trials: Trials) -> Found:
        actions, status = np.empty_like(trials.played), np.empty(trials.played.shape[:2], int)
        for episode, step in np.ndindex(*status.shape):
            if step == 0:
                policy.begin()
            found = policy.run({name: trials.observations[episode, step] for name in policy.inputs})
            actions[episode, step], status[episode, step] = found["action"], int(found[STATUS][0])
            if not np.isnan(trials.played[episode, step]).any():
                policy.acted(trials.played[episode, step])
        return actions, status

    return run


def onnx_runner(file: Path) -> Runner:
    """Runs the ONNX form with onnxruntime, all episodes at once.

    Raises:
        ConfigError: it is not installed.
    """
    runtime = imported("onnxruntime")
    options = runtime.SessionOptions()
    options.intra_op_num_threads = 1
    session = runtime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
    inputs = [entry.name for entry in session.get_inputs()]
    outputs = [entry.name for entry in session.get_outputs()]
    carries = json.loads(session.get_modelmeta().custom_metadata_map["carries"])
    starts = {carry["name"]: np.array([carry["start"]], np.float32) for carry in carries}  # None becomes NaN
    widths = {entry.name: entry.shape[1] for entry in session.get_inputs()}

    def run(trials: Trials) -> Found:
        episodes, steps, _ = trials.observations.shape
        carry = {name: np.repeat(start, episodes, axis=0) for name, start in starts.items()}
        actions, status = np.empty_like(trials.played), np.empty((episodes, steps), int)
        own = [name for name in inputs if name not in starts]
        for step in range(steps):
            rows = np.ascontiguousarray(trials.observations[:, step])
            feeds = {own[0]: rows} if len(own) == 1 and widths[own[0]] == rows.shape[1] else {}
            feeds = feeds or {name: np.ascontiguousarray(rows[:, [k]]) for k, name in enumerate(own)}
            found = dict(zip(outputs, session.run(outputs, feeds | carry), strict=True))
            actions[:, step], status[:, step] = found["action"], found[STATUS]
            carry = {name: found[f"next_{name}"] for name in starts}
            told = ~np.isnan(trials.played[:, step]).any(axis=1)
            for name in (each["name"] for each in carries if each["of"] == "action"):
                carry[name][told, : trials.played.shape[2]] = trials.played[told, step]
        return actions, status

    return run


def compiler() -> str | None:
    """The C compiler of this machine: the environment variable CC, or `cc`; None where there is none."""
    return shutil.which(os.environ.get("CC", "") or "cc")


def c_runner(header: Path, command: str, folder: Path) -> Runner:
    """Compiles the header, in the folder, into a program that answers one step after another, and runs that."""
    source, program, text = folder / "run.c", folder / "run", header.read_text("ascii")
    acted = "policy_acted(given + 1 + COLUMNS)" if "policy_acted(" in text else "(void)0"
    source.write_text(DRIVER % {"acted": acted}, encoding="ascii")
    _run([command, "-std=c99", "-O2", f"-I{header.parent}", str(source), "-lm", "-o", str(program)], header.name)

    def run(trials: Trials) -> Found:
        begins = np.zeros((*trials.played.shape[:2], 1), np.float32)
        begins[:, 0] = 1.0
        given = np.concatenate([begins, trials.observations, trials.played], axis=2).astype(np.float32)
        answer = np.frombuffer(_run([str(program)], header.name, given.tobytes()), np.float32)
        actions = trials.played.shape[2]
        answer = answer.reshape(*trials.played.shape[:2], 1 + actions)
        return answer[:, :, 1:], answer[:, :, 0].astype(int)

    return run


def vectors(
    trials: Trials, wanted: Found, rounding: Rounding, half: np.ndarray, close: np.ndarray | None
) -> dict[str, Any]:
    """First steps of episodes whose actions every sound compiler finds to 1e-5, for the test shipped with the C form.

    Args:
        trials: to choose from.
        wanted: what the policy does in them.
        rounding: of the program.
        half: [act_dim] of the range of each action.
        close: [episodes] those that may be chosen; None allows all.

    Returns:
        As `odaf.deployment.c_form.write_c_test` takes them.
    """
    count = max(_EPISODES // (2 * trials.observations.shape[1]), 4)
    kept: list[tuple[int, int]] = []  # an episode, and so many of its first steps
    for episode in range(len(trials.observations)) if close is None else np.flatnonzero(close).tolist():
        status, steps, known = wanted[1][episode], 0, False
        for step in range(len(status)):
            if status[step] in (FINE, ALARM):
                until = trials.part(slice(episode, episode + 1), step + 1)
                if not (rounding(until) <= _MARGIN * TOLERANCE * half).all():
                    break
                known = True
            steps = step + 1
        if known:
            kept.append((episode, steps))
        if len(kept) == count:
            break
    begin = np.zeros(trials.played.shape[:2], int)
    begin[:, 0] = 1
    fields = {
        "begin": begin,
        "status": wanted[1],
        "observation": trials.observations,
        "action": wanted[0],
        "played": trials.played,
    }
    return {name: np.concatenate([field[each, :steps] for each, steps in kept]) for name, field in fields.items()}


def run_c_test(source: Path, command: str, folder: Path) -> None:
    """Compiles the shipped test in the folder and runs it.

    Raises:
        ConfigError: it fails.
    """
    program = folder / "test"
    _run([command, "-std=c99", "-O2", str(source), "-lm", "-o", str(program)], source.name)
    _run([str(program)], source.name)


def _check_refusals(form: str, runner: Runner, trials: Trials) -> None:
    """A number that is not finite, in any column, is refused."""
    columns = trials.observations.shape[2]
    broken = np.repeat(trials.observations[:1, :1], 3 * columns, axis=0)
    for place, wrong in enumerate((np.nan, np.inf, -np.inf)):
        broken[place * columns + np.arange(columns), 0, np.arange(columns)] = wrong
    nobody = np.full((len(broken), 1, trials.played.shape[2]), np.nan, np.float32)
    actions, status = runner(Trials(broken, nobody))
    if not ((status == NOT_FINITE).all() and np.isnan(actions).all()):
        at = int(np.argmax((status[:, 0] != NOT_FINITE) | ~np.isnan(actions).all(axis=(1, 2))))
        raise ConfigError(
            f"{form}: takes {['nan', 'inf', '-inf'][at // columns]} in column {at % columns} for a reading; leave this "
            "form out with forms=, and report it"
        )


def _moved(kind: str, function: Callable[..., np.ndarray], rng: np.random.Generator) -> Callable[..., np.ndarray]:
    """An operation whose result is off by what single precision may round away."""

    weight, sizes = None, np.empty(0)

    def operate(*arguments: np.ndarray, **attributes: Any) -> np.ndarray:
        nonlocal weight, sizes
        result = function(*arguments, **attributes)
        if kind in ("add", "subtract", "multiply", "sum") and all(map(_small_and_whole, arguments)):
            return result  # of flags and of what a status is made of: single precision is exact there
        size = np.abs(result)
        if kind == "affine":
            if weight is not arguments[1]:  # the same at every step
                weight, sizes = arguments[1], np.abs(arguments[1])
            size = np.abs(arguments[0]) @ sizes
        elif kind in ("sum", "mean"):
            size = function(np.abs(arguments[0]), **attributes)
        elif kind == "standardise":
            spread = np.sqrt(arguments[0].var(axis=2, keepdims=True) + attributes["epsilon"])
            size = size + np.abs(arguments[0]).max(axis=2, keepdims=True) / spread
        elif kind not in ("add", "subtract", "multiply", "divide", "silu", "tanh", "exp", "sqrt"):
            return result
        return result + _UNIT * size * rng.uniform(-1.0, 1.0, result.shape)

    return operate


def _small_and_whole(numbers: np.ndarray) -> bool:
    return bool(((np.rint(numbers) == numbers) & (np.abs(numbers) <= 1_024.0)).all())


def _last_action(policy: odaf_policy.Policy, trials: Trials) -> np.ndarray:
    policy.begin()
    found: dict[str, np.ndarray] = {}
    for observation, played in zip(trials.observations[0], trials.played[0], strict=True):
        found = policy.run({name: observation for name in policy.inputs})
        if not np.isnan(played).any():
            policy.acted(played)
    return found["action"]


def _run(words: list[str], what: str, given: bytes = b"") -> bytes:
    done = subprocess.run(words, input=given, capture_output=True)
    if done.returncode:
        said = (done.stderr or done.stdout).decode(errors="replace").strip()
        raise ConfigError(
            f"{what}: {Path(words[0]).name} fails ({said[:300]}); install a C compiler, name one in the environment "
            "variable CC, or leave this form out with forms=['numpy', 'onnx']"
        )
    return done.stdout


def _refuse(form: str, what: str, trials: Trials, episode: int) -> None:
    shown = np.array2string(trials.observations[episode, 0], threshold=8, precision=4)
    raise ConfigError(
        f"{form}: {what}, in an episode that begins with {shown}; leave this form out with forms=, and report it, with "
        "the versions of the packages"
    )
