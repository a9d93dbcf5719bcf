"""Builds the wheel, installs it into an empty environment, and trains from there, outside the checkout.

    python -m tools.wheel [FOLDER]

What the checkout hides is found so: a file that does not come along, a dependency that only an extra brings, an entry
point that is not made. The wheel is left in FOLDER (dist). Dependencies of the core come in the versions of
requirements.lock; nothing is kept outside the checkout.
"""

import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
import zipfile
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PIP = [
    sys.executable,
    "-m",
    "pip",
    "--disable-pip-version-check",
    "--quiet",
    "--cache-dir",
    str(ROOT / ".cache" / "pip"),
]
SOURCES = ("src", "pyproject.toml", "README.md", "LICENSE")

# What runs in the empty environment. It sees the installed package alone.
TRIAL = """
import contextlib, importlib.util, io, random
from pathlib import Path

import odaf
from odaf.cli import main
from odaf.runs import presets

assert "site-packages" in odaf.__file__, odaf.__file__
for extra in ("gymnasium", "mujoco", "matplotlib", "jinja2", "pyarrow", "pytest"):
    assert importlib.util.find_spec(extra) is None, f"{extra} came along with the core"

small = ["--steps", "40", "--seeds", "0", "--batch-size", "16", "--hidden-sizes", "8", "8"]
outcome = ["--num-critics", "2", "--outcome.num-states", "8", "--outcome.dynamics.steps", "20"]
assert main(["train", "odaf", "--data", "log.h5", "--out", "runs/odaf", *small, *outcome]) == 0
for run in ("runs/cloning", "runs/odaf"):
    policy = odaf.load_run(run).policy(seed=0)
    policy.save("policy.safetensors")
    (action,) = odaf.Policy.load("policy.safetensors")({"level": 1.0, "flow": 0.5})
    assert 0.0 <= action <= 100.0 and action == policy({"level": 1.0, "flow": 0.5})[0], action

train = ["train", "behaviour-cloning", "--data", "log.h5", "--out", "runs/more"]
refused = {
    "report": ["report", "runs/odaf", "--out", "report.html"],
    "envs": ["data", "generate", "pointmaze-stitch", "--out", "maze.h5"],
    "tensorboard": [*train, "--log-to", "tensorboard"],
    "wandb": [*train, "--log-to", "wandb"],
    "mlflow": [*train, "--log-to", "mlflow"],
    "ray": ["reproduce", "theory", "--ray", "local"],
}
for extra, words in refused.items():
    with contextlib.redirect_stderr(io.StringIO()) as said:
        assert main(words) == 2, words
    assert f"odaf[{extra}]" in said.getvalue(), (words, said.getvalue())
print(f"{len(presets.names())} presets, two policies, {len(refused)} extras named where they are missing")
"""


def log_table(path: Path) -> None:
    """A log that needs no simulator: 6 episodes of 30 rows at a tank."""
    lines = ["episode,level,flow,valve,profit"]
    for row in range(180):
        level, flow, valve = 1.0 + 0.37 * row % 0.8, 0.23 * row % 1.0, 5.5 + 13.7 * row % 90.0
        lines.append(f"{row // 30},{level:.3f},{flow:.3f},{valve:.2f},{1.0 - abs(level - 1.0):.3f}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def build(folder: Path, scratch: Path) -> Path:
    """The wheel, made from a copy, so that no file of an earlier build can slip in."""
    copy = scratch / "source"
    copy.mkdir()
    for name in SOURCES:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, copy / name, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
        else:
            shutil.copy(source, copy / name)
    run([*PIP, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", str(scratch / "made"), str(copy)], scratch)
    (made,) = (scratch / "made").glob("*.whl")
    folder.mkdir(parents=True, exist_ok=True)
    for earlier in folder.glob("odaf-*.whl"):
        earlier.unlink()
    return Path(shutil.copy(made, folder / made.name))


def left_out(wheel: Path) -> list[str]:
    """Files of the package that the wheel does not hold."""
    package = ROOT / "src" / "odaf"
    files = {str(path.relative_to(package.parent)) for path in package.rglob("*") if path.is_file()}
    with zipfile.ZipFile(wheel) as archive:
        return sorted(name for name in files - set(archive.namelist()) if "__pycache__" not in name)


def run(words: list[str], folder: Path) -> str:
    """What a command in a folder outside the checkout prints; one that fails ends this program with its words."""
    foreign = ("PYTHON", "ODAF_", "VIRTUAL_ENV")
    environment = {name: value for name, value in os.environ.items() if not name.startswith(foreign)}
    environment["ODAF_CACHE_DIR"] = str(folder / "compiled")
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{done.stdout}{done.stderr}\n{' '.join(words)[:200]}\nended with {done.returncode}")
    return done.stdout


def main() -> None:
    """Builds, installs, trains; says how long each took."""
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "dist").resolve()
    times = [time.monotonic()]
    with tempfile.TemporaryDirectory(prefix="odaf-wheel-") as name:
        scratch = Path(name)
        wheel = build(folder, scratch)
        if missing := left_out(wheel):
            sys.exit(f"{wheel}: lacks {', '.join(missing)}; see [tool.setuptools.package-data] in pyproject.toml")
        times.append(time.monotonic())

        environment, work = scratch / "environment", scratch / "work"
        work.mkdir()
        run([sys.executable, "-m", "venv", "--without-pip", str(environment)], scratch)
        scripts = Path(sysconfig.get_path("scripts", "venv", {"base": str(environment)}))
        python = str(scripts / "python")
        lock = ["--constraint", str(ROOT / "requirements.lock")]
        run([*PIP, "--python", python, "install", "--no-compile", *lock, str(wheel)], scratch)
        times.append(time.monotonic())

        log_table(work / "log.csv")
        odaf = str(scripts / "odaf")
        columns = "--observations level flow --actions valve --reward profit --episode episode --action-bounds 0 100"
        run([odaf, "data", "import", "log.csv", "--out", "log.h5", *columns.split()], work)
        small = "--steps 40 --seeds 0 --batch-size 16 --hidden-sizes 8"
        run([odaf, "train", "behaviour-cloning", "--data", "log.h5", "--out", "runs/cloning", *small.split()], work)
        print(run([python, "-c", TRIAL], work).splitlines()[-1])
        times.append(time.monotonic())
    built, installed, trained = (after - before for before, after in pairwise(times))
    print(f"{wheel.name}: built in {built:.0f} s, installed in {installed:.0f} s, trained from in {trained:.0f} s")


if __name__ == "__main__":
    main()
