"""The online loop: play some steps, make as many updates, look at the policy now and then.

A run directory holds `config.json`, `curve.jsonl` (a line an evaluation), `snapshots/STEP.npz` (actors),
`replay.npy` (every step played) and the newest checkpoint. A run that was stopped goes on from its last checkpoint and
gives the bits that an unbroken run would have given. What is learnt, by which learner and how it is judged, is the
task's: see `odaf.behaviour.task`.
"""

import dataclasses
import json
import shutil
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.algorithms.base import Algorithm, LearnerState, Metrics
from odaf.behaviour.replay import Replay, unpack
from odaf.behaviour.task import Body, OnlineTask
from odaf.behaviour.tasks import online_task
from odaf.components.policies import Actor, GaussianActor
from odaf.data.writing import write_text
from odaf.environments.contact_margins import ContactMargins, check
from odaf.environments.gaussian_policy import GaussianPolicy
from odaf.errors import ConfigError
from odaf.training import checkpoints
from odaf.training.files import plain, write_arrays, write_json
from odaf.training.progress import ProgressReport, Silent


@dataclasses.dataclass(frozen=True)
class OnlineRun:
    """Settings of one run."""

    task: str
    """halfcheetah, hopper, walker2d or ant."""
    version: str = "v4"
    """Environment version; of the ant there is "v0" only."""
    seed: int = 0
    """The same seed gives the same bits on the same machine and versions."""
    steps: int = 1_000_000
    """Environment steps, the random ones included."""
    random_steps: int = 10_000
    """Steps with uniform actions before the first update."""
    batch_size: int = 256
    """Transitions an update; half of it makes an update cost three fifths."""
    stretch: int = 50
    """Steps played with one set of parameters, then as many updates in one compiled call."""
    evaluate_every: int = 25_000
    """Steps between evaluations."""
    episodes: int = 10
    """Episodes of one evaluation."""
    snapshot_every: int = 5_000
    """Steps between copies of the actor."""
    checkpoint_every: int = 50_000
    """Steps between checkpoints."""
    contact_margins: ContactMargins | None = None
    """How MuJoCo counts the margins of two geoms that touch, "added" or "larger"; None is as the installed one does,
    for the ant "larger"."""

    def __post_init__(self) -> None:
        self.learns()
        check(self.contact_margins)
        for field in ("steps", "random_steps", "evaluate_every", "snapshot_every", "checkpoint_every"):
            value = getattr(self, field)
            if value < 1 or value % self.stretch:
                raise ConfigError(f"{field}={value} must be a positive multiple of stretch={self.stretch}")

    def learns(self) -> OnlineTask:
        """What it trains for.

        Raises:
            ConfigError: there is no such task or version.
        """
        return online_task(self.task, self.version)

    def algorithm(self) -> Algorithm[Any]:
        """The learner."""
        return self.learns().learner(self.batch_size)

    def bodies(self, count: int) -> list[Any]:
        """So many bodies of its task."""
        return [self.learns().body(self.contact_margins) for _ in range(count)]


@dataclasses.dataclass
class _Position:
    """Where a run is: everything but the learner's state and the replay file."""

    step: int
    rng: np.random.Generator
    observation: np.ndarray
    elapsed: int  # steps of the current episode
    seconds: float


def train(
    run: OnlineRun,
    directory: Path,
    progress: ProgressReport | None = None,
    stop: Callable[[dict[str, Any]], bool] = lambda evaluation: False,
) -> None:
    """Train until `run.steps`, from the newest checkpoint in `directory` if there is one.

    Args:
        run: settings; they must be those of the directory, but for a larger number of steps.
        directory: where everything goes.
        progress: hears how far the run is.
        stop: called with every line of the curve; true ends the run there.

    Raises:
        ConfigError: the directory belongs to a run with other settings.
    """
    progress = progress or Silent()
    task, algorithm = run.learns(), run.algorithm()
    _claim(run, directory)
    (body,) = run.bodies(1)
    replay = Replay(directory / "replay.npy", task, run.steps)
    state, now = _start(run, task, algorithm, body, directory)
    key, updates = jr.key(run.seed), _compiled(algorithm, task)
    began = time.monotonic() - now.seconds
    progress.start(f"{task.environment} seed {run.seed}", run.steps, now.step)
    note = ""
    while now.step < run.steps:
        policy = None if now.step < run.random_steps else policy_of(algorithm.actor(state))
        _play(run, task, body, policy, replay, now)
        if now.step > run.random_steps:
            rows = replay.draw(now.rng.integers(0, now.step, (run.stretch, algorithm.batch_size)))
            state, metrics = updates(state, rows, jr.fold_in(key, now.step))
            if now.step % run.evaluate_every == 0:
                policy = policy_of(algorithm.actor(state))
                played = task.evaluate(policy, run.episodes, run.seed, run.contact_margins)
                line = {"step": now.step, **played, **_means(metrics)}
                now.seconds = line["seconds"] = time.monotonic() - began
                with (directory / "curve.jsonl").open("a", encoding="utf-8") as file:
                    file.write(json.dumps(line) + "\n")
                note = task.in_words(line)
                if stop(line):
                    _save(directory, state, replay, body, now)
                    break
            if now.step % run.snapshot_every == 0:
                save_policy(directory / "snapshots" / f"{now.step:08d}.npz", policy_of(algorithm.actor(state)))
            if now.step % run.checkpoint_every == 0 or now.step == run.steps:
                now.seconds = time.monotonic() - began
                _save(directory, state, replay, body, now)
        progress.advance(now.step, note)
    progress.close()


def run_in(directory: Path) -> OnlineRun:
    """The settings of the run in a directory.

    Raises:
        ConfigError: there is none.
    """
    path = directory / "config.json"
    if not path.exists():
        raise ConfigError(f"{directory}: holds no training run; make one with `odaf behaviour train`")
    return OnlineRun(**json.loads(path.read_text(encoding="utf-8"))["run"])


def curve_in(directory: Path) -> list[dict[str, Any]]:
    """The lines of a run's learning curve so far."""
    path = directory / "curve.jsonl"
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    return [json.loads(line) for line in lines]


def policy_of(actor: Actor) -> GaussianPolicy:
    """The actor on the host."""
    assert isinstance(actor, GaussianActor)  # the task says so of its learner
    network = actor.network
    return GaussianPolicy([np.asarray(w) for w in network.weights], [np.asarray(b) for b in network.biases])


def save_policy(path: Path, policy: GaussianPolicy) -> None:
    """Writes the arrays of a policy."""
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {f"weight_{index}": weight for index, weight in enumerate(policy.weights)}
    arrays |= {f"bias_{index}": bias for index, bias in enumerate(policy.biases)}
    write_arrays(path, arrays)


def load_policy(path: Path) -> GaussianPolicy:
    """Inverse of `save_policy`."""
    with np.load(path, allow_pickle=False) as content:
        layers = range(len(content.files) // 2)
        weights, biases = ([content[f"{name}_{layer}"] for layer in layers] for name in ("weight", "bias"))
    return GaussianPolicy(weights, biases)


def _play(
    run: OnlineRun, task: OnlineTask, body: Body, policy: GaussianPolicy | None, replay: Replay, now: _Position
) -> None:
    """Plays one stretch; without a policy, uniform actions."""
    size = run.stretch, task.act_dim
    if policy is None:
        draws = now.rng.uniform(-1.0, 1.0, size).astype(np.float32)
    else:
        draws = now.rng.standard_normal(size, dtype=np.float32)
    for draw in draws:
        action = draw if policy is None else policy.sample(now.observation, draw)
        pose = body.body()
        observation, reward, terminated = body.step(action)
        now.elapsed += 1
        cut = now.elapsed >= task.time_limit
        replay.write(now.step, now.observation, action, reward, observation, terminated, cut and not terminated, pose)
        now.step += 1
        if terminated or cut:
            observation, now.elapsed = body.reset(int(now.rng.integers(2**31))), 0
        now.observation = observation


def _compiled(
    algorithm: Algorithm[Any], task: OnlineTask
) -> Callable[[LearnerState, np.ndarray, PRNGKeyArray], tuple[LearnerState, Metrics]]:
    @partial(jax.jit, donate_argnums=0)
    def updates(
        state: LearnerState, rows: Float[Array, "updates batch width"], key: PRNGKeyArray
    ) -> tuple[LearnerState, Metrics]:
        def body(state: LearnerState, one: tuple[Array, PRNGKeyArray]) -> tuple[LearnerState, Metrics]:
            batch, key = one
            return algorithm.update(state, unpack(batch, task.obs_dim, task.act_dim), key)

        state, metrics = jax.lax.scan(body, state, (rows, jr.split(key, rows.shape[0])))
        return state, jax.tree.map(lambda values: values.mean(), metrics)

    return updates


def _means(metrics: Metrics) -> dict[str, float]:
    return {name: float(value) for name, value in metrics.items()}


def _claim(run: OnlineRun, directory: Path) -> None:
    """Makes the directory this run's own, or checks that it is."""
    path, settings = directory / "config.json", plain(dataclasses.asdict(run))
    directory.mkdir(parents=True, exist_ok=True)
    if path.exists():
        before = plain(dataclasses.asdict(run_in(directory)))
        different = [
            f"{name} {before[name]!r}" for name in before if name != "steps" and before[name] != settings[name]
        ]
        if different:
            raise ConfigError(
                f"{directory}: holds a run with other settings ({', '.join(different)}); name another place or remove "
                "it"
            )
        if before["steps"] > run.steps:
            raise ConfigError(
                f"{directory}: holds a run of {before['steps']:,} steps, and {run.steps:,} were asked for; "
                "a run can be made longer, not shorter"
            )
    write_json(path, {"run": settings, "algorithm": dataclasses.asdict(run.algorithm())})


def _start(
    run: OnlineRun, task: OnlineTask, algorithm: Algorithm[Any], body: Body, directory: Path
) -> tuple[LearnerState, _Position]:
    """The newest checkpoint, or the beginning."""
    key, spec = jr.fold_in(jr.key(run.seed), 0), task.spec()
    state = algorithm.init(key, spec, algorithm.untrained(key, spec))
    rng = np.random.default_rng(run.seed)
    curve = directory / "curve.jsonl"
    saved = checkpoints.listed(directory / "checkpoints")
    if not saved:
        write_text(curve, "")
        observation = body.reset(int(rng.integers(2**31)))
        return state, _Position(0, rng, observation, 0, 0.0)
    header = saved[-1].header()
    rng.bit_generator.state = header["rng"]
    body.restore(np.array(header["physics"]))
    lines = [
        line for line in curve.read_text(encoding="utf-8").splitlines() if json.loads(line)["step"] <= header["step"]
    ]
    write_text(curve, "".join(line + "\n" for line in lines))
    observation = np.array(header["observation"])
    return saved[-1].load(state), _Position(header["step"], rng, observation, header["elapsed"], header["seconds"])


def _save(directory: Path, state: LearnerState, replay: Replay, body: Body, now: _Position) -> None:
    """Writes a checkpoint, then removes the older ones."""
    replay.flush()
    older = checkpoints.listed(directory / "checkpoints")
    record = {
        "rng": now.rng.bit_generator.state,
        "physics": body.physics().tolist(),
        "observation": now.observation.tolist(),
        "elapsed": now.elapsed,
        "seconds": now.seconds,
    }
    checkpoints.save(directory / "checkpoints", now.step, state, record)
    for checkpoint in older:
        if checkpoint.step != now.step:
            shutil.rmtree(checkpoint.path)
