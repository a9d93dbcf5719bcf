"""Run directories as training leaves them, written file by file without any training."""

import json

import numpy as np
import pytest

MAZE = {
    "name": "stitch",
    "rows": ["111111", "100111", "100001", "111111"],
    "start": [1, 2],
    "goal": [2, 4],
    "avoid": [[1, 1], [2, 1]],
}
S, M, G, A, B = (-0.5, 0.5), (-0.5, -0.5), (1.5, -0.5), (-1.5, 0.5), (-1.5, -0.5)
TIME = 41


def drive(rng, count, *cells):
    """[count, TIME, 4] noisy paths through cell centres, with velocities."""
    corners = np.asarray(cells) + rng.uniform(-0.2, 0.2, (count, len(cells), 2))
    at = np.linspace(0, len(cells) - 1, TIME)
    left = np.minimum(at.astype(int), len(cells) - 2)
    positions = corners[:, left] + (at - left)[None, :, None] * (corners[:, left + 1] - corners[:, left])
    return np.concatenate([positions, np.gradient(positions, axis=1)], axis=2).astype(np.float32)


def write_json(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def write_data(directory, seed=0, environment=True, provenance=None):
    rng = np.random.default_rng(seed)
    logged = np.concatenate([drive(rng, 20, S, M), drive(rng, 20, S, A, B, M, G)])
    returns = np.concatenate([rng.normal(26.7, 3, 500), rng.normal(54.0, 5, 500)]).clip(5, 72.63)
    returns[-1] = 72.63
    np.savez(directory / "data_sample.npz", returns=returns, best_observations=logged[-1], observations=logged)
    if provenance is None:
        provenance = {"generator": "odaf.environments.stitch_data", "seed": 0}
    write_json(
        directory / "data.json",
        {
            "path": "stitch.h5",
            "sha256": "ab12" * 16,
            "summary": {
                "transitions": 199000, "episodes": 1000, "mean_return": float(returns.mean()), "std_return": 14.0,
                "best_return": 72.63, "worst_return": 5.0, "mean_length": 199.0, "terminal_share": 0.0,
                "observation_names": ["x", "y", "vx", "vy"], "action_names": ["fx", "fy"], "provenance": provenance,
            },
            "spec": {
                "obs_dim": 4, "act_dim": 2, "action_low": [-1, -1], "action_high": [1, 1], "reward_min": 0.03,
                "reward_max": 0.998, "ever_terminates": False, "max_episode_length": 199,
            },
            "normaliser": {"mean": [0, 0, 0, 0], "std": [1, 1, 1, 1]},
            "environment": {"name": "pointmaze", "maze": MAZE, "steps": 200} if environment else None,
        },
    )  # fmt: skip


def write_seed(directory, seed, level, stitches, *, critic, finished=True, evaluated=True, steps=20000, warnings=()):
    """One seed whose mean return climbs to about `level`; `stitches` is the share of episodes that stitch."""
    rng = np.random.default_rng(seed)
    folder = directory / f"seed-{seed}"
    folder.mkdir(parents=True)
    lines = []
    evaluation = {}
    for step in range(1000, (steps if finished else steps // 2) + 1, 1000):
        line = {"step": step, "actor/loss": -step / 1000, "time/updates_per_second": 61.5, "time/seconds": step / 61.5}
        if critic:
            mean = 38 * (1 - np.exp(-step / 9000)) + rng.normal(0, 0.4)
            line |= {"critic/mean": mean, "critic/min": 0.2 * mean - 1, "critic/max": 1.9 * mean + 3,
                     "temperature/value": float(np.exp(-step / 4000)),
                     "outcome/uncertainty": 0.2 + 2 * np.exp(-step / 5000)}  # fmt: skip
        lines.append(line)
        if evaluated and step % 5000 == 0:
            mean = level * (1 - np.exp(-((step / 8000) ** 3))) + rng.normal(0, 2)
            returns = rng.normal(mean, 5, 50)
            evaluation = {
                "step": step, "mean_return": float(returns.mean()), "std_return": float(returns.std()),
                "success_rate": stitches, "stitched_rate": stitches, "episodes": 50, "returns": returns.tolist(),
            }  # fmt: skip
            lines.append(
                {
                    "step": step, "evaluation/return_mean": evaluation["mean_return"],
                    "evaluation/return_std": evaluation["std_return"], "evaluation/success_rate": stitches,
                    "evaluation/stitched_rate": stitches, "evaluation/episodes": 50,
                }
            )  # fmt: skip
            good = round(50 * stitches)
            paths = np.concatenate([drive(rng, good, S, M, G), drive(rng, 50 - good, S, M, M)])
            (folder / "evaluations").mkdir(exist_ok=True)
            np.savez(
                folder / "evaluations" / f"{step:08d}.npz", observations=paths, returns=returns,
                rewards=np.zeros((50, TIME - 1), np.float32), lengths=np.full(50, TIME - 1),
                success=np.arange(50) < good, stitched=np.arange(50) < good,
            )  # fmt: skip
    (folder / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    if finished:
        pretrain: dict = {"warnings": []}
        if critic:
            pretrain["outcome"] = {
                "kind": "deterministic", "training_loss": 1e-4, "holdout_rows": 9950, "holdout_mse": 2.0e-4,
                "holdout_mse_by_dimension": [1e-5, 2e-5, 3e-4, 5e-4], "no_change_mse": 5.5e-3,
                "no_change_mse_by_dimension": [4e-4, 3e-4, 1.1e-2, 9e-3], "error_ratio": 0.036,
            }  # fmt: skip
        write_json(
            folder / "summary.json",
            {
                "seed": seed, "step": steps, "status": "finished", "evaluation": evaluation or None,
                "updates_per_second": 61.5, "pretrain": pretrain, "warnings": list(warnings),
                "seconds": {"pretrain": 12.0, "train": 325.0 + seed, "evaluate": 8.0, "total": 345.0},
            },
        )  # fmt: skip


def write_run(directory, preset="odaf", level=121.0, stitches=1.0, seeds=(0, 1), *, critic=True, data=None, **options):
    """A whole run directory; `data` are options of `write_data`, the rest those of `write_seed`."""
    directory.mkdir(parents=True)
    algorithm = {"kind": "behaviour-cloning", "hidden_sizes": [256, 256], "discount": 0.99}
    if critic:
        algorithm = {
            "kind": "ensemble-sac", "num_critics": 10, "critic_norm": "layer", "discount": 0.99,
            "terms": [{"kind": "outcome", "weight": 0.3 if preset == "odaf" else 0.0, "radius": 0.01}],
        }  # fmt: skip
    write_json(
        directory / "config.json",
        {
            "preset": preset, "algorithm": algorithm, "steps": 20000, "seeds": list(seeds),
            "evaluate": {"episodes": 50, "every": 5000}, "format": "odaf-run", "version": 1,
        },
    )  # fmt: skip
    write_json(
        directory / "environment.json",
        {
            "python": "3.11.9", "versions": {"jax": "0.10.2", "odaf": "0.1.0"}, "device": "cpu", "platform": "Linux",
            "command": ["/somewhere/bin/odaf", "train", preset, "--data", "my data.h5", "--steps", "20000"],
        },
    )  # fmt: skip
    write_data(directory, **(data or {}))
    for seed in seeds:
        write_seed(directory, seed, level, stitches, critic=critic, **options)
    return directory


@pytest.fixture(scope="session")
def run_writer():
    """`write_run`, for tests that make their own run directories."""
    return write_run
