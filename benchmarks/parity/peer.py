"""d3rlpy's side, run by an interpreter that has it: `python -m benchmarks.parity.peer export|train ...`.

`export` makes one update of a learner at `STANDSTILL` rates, from random weights, on a random batch, and writes all
that went in and came out as plain arrays:

    weights/MODULE.PARAMETER      before the update
    batch/COLUMN
    noise/NUMBER                  each array of random numbers that the update drew, in the order of drawing
    loss/NAME                     as d3rlpy reports it
    gradient/MODULE.PARAMETER     when the optimiser was about to step
    after/MODULE.PARAMETER        of the slow copies, after the update

`train` trains on a file of rows that `scores.py` wrote, and writes the weights.
"""

import argparse
import contextlib
import json
import math
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import d3rlpy  # pyright: ignore[reportMissingImports]
import numpy as np
import torch  # pyright: ignore[reportMissingImports]
from d3rlpy.dataset import TransitionMiniBatch  # pyright: ignore[reportMissingImports]
from d3rlpy.models import VectorEncoderFactory  # pyright: ignore[reportMissingImports]

from benchmarks.parity.settings import ACT_DIM, LEARNERS, OBS_DIM, ROWS, STANDSTILL, for_losses


def configured(name: str, settings: dict[str, Any], **scalers: Any) -> Any:
    """d3rlpy's learner with our settings."""
    widths = list(settings.get("hidden_sizes") or settings["actor_hidden_sizes"])
    encoder = VectorEncoderFactory(widths)
    critic = VectorEncoderFactory(list(settings.get("critic_hidden_sizes", widths)))
    both = {"actor_encoder_factory": encoder, "critic_encoder_factory": critic}
    imitator = {"imitator_encoder_factory": VectorEncoderFactory(list(settings.get("behaviour_hidden_sizes", widths)))}
    shared = {"batch_size": settings["batch_size"], **scalers}
    algorithms = d3rlpy.algos
    match name:
        case "behaviour-cloning":
            config = algorithms.BCConfig(learning_rate=settings["learning_rate"], encoder_factory=encoder, **shared)
        case "td3-bc":
            config = algorithms.TD3PlusBCConfig(
                alpha=settings["value_weight"],
                actor_learning_rate=settings["learning_rate"],
                critic_learning_rate=settings["learning_rate"],
                **_twin_delayed(settings),
                **both,
                **shared,
            )
        case "rebrac":
            factory = NormedFactory if settings.get("norm") == "before" else VectorEncoderFactory
            critic = factory(widths, use_layer_norm=True)
            config = algorithms.ReBRACConfig(
                actor_beta=settings["actor_penalty"],
                critic_beta=settings["critic_penalty"],
                actor_learning_rate=settings["actor_learning_rate"],
                critic_learning_rate=settings["critic_learning_rate"],
                **_twin_delayed(settings),
                **(both | {"critic_encoder_factory": critic}),
                **shared,
            )
        case "iql":
            config = algorithms.IQLConfig(
                expectile=settings["expectile"],
                weight_temp=settings["inverse_temperature"],
                max_weight=settings["weight_cap"],
                gamma=settings["discount"],
                tau=settings["target_rate"],
                actor_learning_rate=settings["learning_rate"],
                critic_learning_rate=settings["learning_rate"],
                value_encoder_factory=encoder,
                **both,
                **shared,
            )
        case "cql":
            gap = settings["lagrange_gap"]
            config = algorithms.CQLConfig(
                conservative_weight=settings["conservative_weight"],
                n_action_samples=settings["num_actions"],
                alpha_threshold=0.0 if gap is None else gap,
                alpha_learning_rate=0.0 if gap is None else settings["critic_learning_rate"],
                temp_learning_rate=settings["temperature_learning_rate"],
                **_rates(settings),
                **both,
                **shared,
            )
        case "bcq":
            config = algorithms.BCQConfig(
                action_flexibility=settings["perturbation"],
                n_action_samples=settings["num_actions"],
                lam=settings["lowest_weight"],
                gamma=settings["discount"],
                tau=settings["target_rate"],
                actor_learning_rate=settings["learning_rate"],
                critic_learning_rate=settings["learning_rate"],
                imitator_learning_rate=settings["learning_rate"],
                **both,
                **imitator,
                **shared,
            )
        case "bear":
            config = algorithms.BEARConfig(
                mmd_kernel=settings["kernel"],
                mmd_sigma=settings["kernel_width"],
                alpha_threshold=settings["threshold"],
                n_mmd_action_samples=settings["num_draws"],
                n_target_samples=settings["num_actions"],
                lam=settings["lowest_weight"],
                warmup_steps=settings["warm_up_steps"],
                imitator_learning_rate=settings["behaviour_learning_rate"],
                alpha_learning_rate=settings["weight_learning_rate"],
                initial_temperature=settings.get("initial_temperature", 1.0),
                **_rates(settings),
                **both,
                **imitator,
                **shared,
            )
        case _:
            raise SystemExit(f"{name}: not known here")
    return config.create(device="cpu")


class NormedFactory(VectorEncoderFactory):
    """Layers that are normalised before the activation, as ours are; d3rlpy's own are so after it."""

    def create_with_action(self, *arguments: Any, **options: Any) -> Any:
        encoder = super().create_with_action(*arguments, **options)
        layers = list(encoder._layers)
        for place in range(0, len(layers), 3):
            layers[place + 1], layers[place + 2] = layers[place + 2], layers[place + 1]
        encoder._layers = torch.nn.Sequential(*layers)
        return encoder


def _rates(settings: dict[str, Any]) -> dict[str, Any]:
    return {
        "gamma": settings["discount"],
        "tau": settings["target_rate"],
        "actor_learning_rate": settings["actor_learning_rate"],
        "critic_learning_rate": settings["critic_learning_rate"],
    }


def _twin_delayed(settings: dict[str, Any]) -> dict[str, Any]:
    return {
        "gamma": settings["discount"],
        "tau": settings["target_rate"],
        "target_smoothing_sigma": settings["target_noise"],
        "target_smoothing_clip": settings["noise_clip"],
        "update_actor_interval": settings["actor_delay"],
    }


# ---- one update, with all that goes in and comes out -----------------------------------------------------------------


class Given:
    """Random numbers of ours in place of PyTorch's, kept in the order in which they are asked for.

    Args:
        seed: of the numbers.
        several: an array of this shape begins with the one that was drawn before it, so that the first of several draws
            is the single one.
    """

    def __init__(self, seed: int, several: tuple[int, ...] | None = None):
        self._random = np.random.default_rng(seed)
        self._several = several
        self.drawn: list[np.ndarray] = []

    def normal(self, *shape: Any, **_: Any) -> torch.Tensor:
        """In place of `torch.randn` and of what `torch.distributions.Normal` draws from."""
        sizes = tuple(shape[0]) if len(shape) == 1 and not isinstance(shape[0], int) else shape
        array = self._random.normal(size=sizes)
        if self._several == sizes:
            array[0] = next(before for before in reversed(self.drawn) if before.shape == sizes[1:])
        return self._kept(array)

    def uniform(self, tensor: torch.Tensor, low: float, high: float) -> torch.Tensor:
        """In place of `Tensor.uniform_`."""
        return tensor.copy_(self._kept(self._random.uniform(low, high, size=tuple(tensor.shape))))

    def _kept(self, array: np.ndarray) -> torch.Tensor:
        self.drawn.append(array.astype(np.float32))
        return torch.from_numpy(self.drawn[-1].copy())

    @contextlib.contextmanager
    def instead(self) -> Iterator[None]:
        """While it lasts, d3rlpy draws from here."""
        of_distributions = torch.distributions.normal
        before = torch.randn, torch.Tensor.uniform_, of_distributions._standard_normal
        torch.randn = self.normal
        torch.Tensor.uniform_ = lambda tensor, low=0.0, high=1.0: self.uniform(tensor, low, high)
        of_distributions._standard_normal = lambda shape, dtype, device: self.normal(tuple(shape))
        try:
            yield
        finally:
            torch.randn, torch.Tensor.uniform_, of_distributions._standard_normal = before


def export(name: str, out: Path, seed: int = 0) -> None:
    """One update of d3rlpy's learner as plain arrays."""
    settings = for_losses(name)
    d3rlpy.seed(seed)
    learner = configured(name, settings | {"norm": "before", "initial_temperature": STANDSTILL})
    learner.create_impl((OBS_DIM,), ACT_DIM)
    modules = learner.impl.modules.get_torch_modules()
    random = np.random.default_rng(seed)
    with torch.no_grad():  # biases too, and slow copies of their own
        for module in modules.values():
            for parameter in module.parameters():
                parameter += torch.from_numpy(0.3 * random.normal(size=tuple(parameter.shape)).astype(np.float32))
    content: dict[str, Any] = {f"weights/{key}": value for key, value in _parameters(modules).items()}

    batch = {
        "observations": random.normal(size=(ROWS, OBS_DIM)),
        "actions": random.uniform(-0.95, 0.95, size=(ROWS, ACT_DIM)),
        "rewards": random.normal(size=(ROWS, 1)),
        "next_observations": random.normal(size=(ROWS, OBS_DIM)),
        "next_actions": random.uniform(-0.95, 0.95, size=(ROWS, ACT_DIM)),
        "terminals": (random.uniform(size=(ROWS, 1)) < 0.25).astype(float),
    }
    batch = {key: value.astype(np.float32) for key, value in batch.items()}
    content |= {f"batch/{key}": value for key, value in batch.items()}
    rows = TransitionMiniBatch(**batch, intervals=np.ones((ROWS, 1), np.float32), transitions=[])

    names = {parameter: key for key, parameter in _named(modules).items()}
    gradients: dict[str, np.ndarray] = {}
    for optimiser in vars(learner.impl.modules).values():
        if hasattr(optimiser, "optim"):
            _record(optimiser, names, gradients)
    mend(learner)
    given = Given(seed + 1, (settings.get("num_draws", 0), ROWS, ACT_DIM))
    with given.instead():
        losses = learner.update(rows)
    content |= {f"noise/{number}": array for number, array in enumerate(given.drawn)}
    content |= {f"loss/{key}": np.float32(value) for key, value in losses.items()}
    content |= {f"gradient/{key}": value for key, value in gradients.items()}
    slow = {key: module for key, module in modules.items() if key.startswith("targ_")}
    content |= {f"after/{key}": value for key, value in _parameters(slow).items()}
    content["about"] = np.frombuffer(json.dumps({"peer": f"d3rlpy {d3rlpy.__version__}"}).encode(), np.uint8)
    out.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(out, **content)


def mend(learner: Any) -> None:
    """Sets two things right in d3rlpy 2.8.1 without which nothing could be compared (losses.py names them)."""
    impl, modules = learner.impl, learner.impl.modules
    if hasattr(modules, "vae_decoder"):
        decode = modules.vae_decoder.forward
        modules.vae_decoder.forward = lambda x, latent, with_squash=True: decode(x, latent, not with_squash)
    if hasattr(modules, "vae_decoder") and hasattr(impl, "update_alpha"):
        update_alpha = impl.update_alpha

        def without_traces(loss: Any) -> None:
            update_alpha(loss)
            modules.actor_optim.zero_grad()

        impl.update_alpha = without_traces


def _record(optimiser: Any, names: dict[Any, str], gradients: dict[str, np.ndarray]) -> None:
    """Lets an optimiser write down its gradients before it steps."""
    step = optimiser.step

    def recorded() -> None:
        for parameter in optimiser._params:
            if parameter.grad is not None:
                gradients[names[parameter]] = parameter.grad.numpy().copy()
        step()

    optimiser.step = recorded


def _named(modules: dict[str, Any]) -> dict[str, Any]:
    return {f"{key}.{name}": p for key, module in modules.items() for name, p in module.named_parameters()}


def _parameters(modules: dict[str, Any]) -> dict[str, np.ndarray]:
    return {key: parameter.detach().numpy().copy() for key, parameter in _named(modules).items()}


# ---- training --------------------------------------------------------------------------------------------------------


def train(name: str, data: Path, out: Path, seed: int, updates: int, every: int) -> None:
    """Trains d3rlpy's learner as its users do, with its own way of drawing batches.

    Writes OUT-UPDATES.npz after every so many updates: the weights, and the seconds until then.
    """
    torch.set_num_threads(1)
    d3rlpy.seed(seed)
    with np.load(data, allow_pickle=False) as file:
        columns = {key: file[key] for key in file.files}
    rows = d3rlpy.dataset.MDPDataset(
        columns["observations"], columns["actions"], columns["rewards"], columns["terminals"], columns["timeouts"]
    )
    scaler = d3rlpy.preprocessing.StandardObservationScaler(columns["mean"], columns["std"], float(columns["epsilon"]))
    scalers: dict[str, Any] = {"observation_scaler": scaler}
    settings = LEARNERS[name]
    if settings.get("reward_scale") == "returns":
        scalers["reward_scaler"] = d3rlpy.preprocessing.MultiplyRewardScaler(float(columns["reward_scale"]))
    learner = configured(name, settings, **scalers)
    learner.build_with_dataset(rows)
    seconds = cpu_seconds = 0.0
    for done in range(every, updates + 1, every):
        start, cpu_start = time.perf_counter(), time.process_time()
        for _ in range(every):
            learner.update(rows.sample_transition_batch(settings["batch_size"]))
        seconds += time.perf_counter() - start
        cpu_seconds += time.process_time() - cpu_start
        print(f"{name} seed {seed}: {done} updates, {seconds:.0f} s", flush=True)
        content: dict[str, Any] = _parameters(learner.impl.modules.get_torch_modules())
        if not all(math.isfinite(float(np.sum(value))) for value in content.values()):
            raise SystemExit(f"{name}: weights are not finite after {done} updates")
        about = {
            "seconds": seconds,
            "cpu_seconds": cpu_seconds,
            "peer": f"d3rlpy {d3rlpy.__version__}",
            "torch": torch.__version__,
        }
        written = np.frombuffer(json.dumps(about).encode(), np.uint8)
        np.savez_compressed(out.with_name(f"{out.name}-{done}.npz"), about=written, **content)


def main() -> None:
    """Runs one of the two."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["export", "train"])
    parser.add_argument("--learner", required=True, choices=list(LEARNERS))
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--updates", type=int, default=20_000)
    parser.add_argument("--every", type=int, default=2_500)
    options = parser.parse_args()
    if options.what == "export":
        export(options.learner, options.out, options.seed)
    else:
        train(options.learner, options.data, options.out, options.seed, options.updates, options.every)


if __name__ == "__main__":
    main()
