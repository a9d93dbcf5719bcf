"""How a run is to go, in one frozen object: what `fit` takes, the command line offers, `config.json` keeps and checks.

What is left open (None) is filled in once, by `RunSettings.resolved`: from the run that is gone on with, or from this
process. So a record always says how many cores, which device and which precision its bits belong to.
"""

import contextlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, Protocol, TypedDict, runtime_checkable

import jax

from odaf.components.critics import usable_cores
from odaf.errors import ConfigError

OnDivergence = Literal["warn", "stop"]
KeepCheckpoints = tuple[int, int] | Literal["all"]
Device = Literal["cpu", "gpu", "tpu"]
Precision = Literal["float32", "tensorfloat32"]

# What JAX calls its three grades, and records did before they named formats. On a GPU the two lower ones are TF32,
# whatever their names say; on a processor all are single precision.
_GRADES = {
    "default": "default", "bfloat16": "default", "fastest": "default",
    "high": "high", "tensorfloat32": "high", "bfloat16_3x": "high",
    "highest": "highest", "float32": "highest",
}  # fmt: skip
# A run's directory belongs to these; the rest only says how the machine is shared, or what a warning leads to.
_COMPARED = (
    "steps", "seeds", "evaluate", "checkpoint_every", "keep_checkpoints", "stretch", "lanes", "widths", "cores",
    "device", "precision",
)  # fmt: skip


@runtime_checkable
class EvaluationSettings(Protocol):
    """How often policies are tried, and how that is written down."""

    @property
    def every(self) -> int:
        """Updates between two evaluations; the last update is always followed by one."""
        ...

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types, for `config.json`."""
        ...


@dataclass(frozen=True)
class RunSettings:
    """How a run is to go."""

    steps: int = 20_000
    """Updates for each seed."""
    seeds: Sequence[int] = (0,)
    """One policy is trained for each; the same seed gives the same policy."""
    evaluate: EvaluationSettings | None = None
    """How policies are tried while they train, every so many updates and after the last; None tries none."""
    checkpoint_every: int = 5_000
    """Updates between two checkpoints; there is one before the first update, before each evaluation and at the end."""
    keep_checkpoints: KeepCheckpoints = (3, 10)
    """Checkpoints that stay: 3 10 keeps the last three and every tenth, 1 0 the last alone, `all` every one."""
    stretch: int = 1_000
    """Updates in one compiled call, and between two lines of metrics."""
    on_divergence: OnDivergence = "warn"
    """What to do when values leave the range that rewards allow. Parameters that are not finite always end training."""
    workers: int | None = None
    """Processes that train seeds side by side; 1 trains them one after another. Without it, Python takes 1, and the
    command line one for each seed up to what the cores allow. With lanes, processes that play policies while training
    goes on; 1 lets it wait. Without it, on an accelerator all cores but one."""
    lanes: int | None = None
    """Trainings (seeds, settings, data sets) in one compiled program; the bits of a run belong to their number. 1
    trains each alone. Without it, 1 on a processor, and on an accelerator all, or as many as its memory holds."""
    widths: tuple[int, int] | None = None
    """Observations and actions that lanes are padded to, so that data sets of other widths share the program; for
    methods that can be padded. Without it, those of the widest data set among several trained together."""
    cores: int | None = None
    """Processor cores that the training of a seed is laid out for; the bits of a run belong to their number. Without
    it, each worker's share of the cores, and for a run that is gone on with the number it was begun with."""
    device: Device | None = None
    """Kind of device to compute on; without it, the fastest that JAX finds."""
    precision: Precision | None = None
    """Format that the factors of matrix products are rounded to; sums are in float32. `tensorfloat32` (10 bits of
    mantissa) is for GPUs alone, where it is faster. Without it, float32, or what JAX was set to."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "seeds", tuple(int(seed) for seed in self.seeds))
        if self.keep_checkpoints != "all":
            object.__setattr__(self, "keep_checkpoints", tuple(map(int, self.keep_checkpoints)))
        if self.widths is not None:
            object.__setattr__(self, "widths", tuple(map(int, self.widths)))
        names = ("steps", "checkpoint_every", "stretch", "workers", "lanes", "cores")
        counts = {name: getattr(self, name) for name in names}
        if self.evaluate is not None:
            counts["evaluate.every"] = self.evaluate.every
        for name, value in counts.items():
            if value is not None and value < 1:
                raise ConfigError(f"{name}: must be at least 1, got {value}")
        if self.widths is not None and min(self.widths) < 1:
            raise ConfigError(f"widths: must be at least 1 each, got {self.widths}")
        if self.steps >= 2**31:
            raise ConfigError(f"steps: must be below 2^31, got {self.steps}")
        distinct, allowed = len(set(self.seeds)) == len(self.seeds), all(0 <= seed < 2**32 for seed in self.seeds)
        if not self.seeds or not distinct or not allowed:
            raise ConfigError(
                f"seeds: must be distinct integers from 0 to 2^32 - 1, at least one, got {list(self.seeds)}"
            )
        self._check_choice("on_divergence", ("warn", "stop"))
        self._check_choice("device", (None, "cpu", "gpu", "tpu"))
        self._check_choice("precision", (None, "float32", "tensorfloat32"))
        if self.keep_checkpoints != "all" and (
            len(self.keep_checkpoints) != 2 or self.keep_checkpoints[0] < 1 or self.keep_checkpoints[1] < 0
        ):
            raise ConfigError(
                f"keep_checkpoints: must be 'all' or two numbers, how many of the last stay (1 or more) and every "
                f"which of the others (0 for none), got {self.keep_checkpoints}"
            )

    def _check_choice(self, name: str, known: tuple[Any, ...]) -> None:
        value = getattr(self, name)
        if value not in known:
            words = ", ".join(repr(choice) for choice in known if choice is not None)
            raise ConfigError(f"{name}: must be one of {words}, got {value!r}")

    def with_changes(self, changes: Mapping[str, Any]) -> "RunSettings":
        """The same with other values for some fields.

        Raises:
            ConfigError: a field does not exist, or a value is out of range.
        """
        known = [field.name for field in fields(self)]
        unknown = [name for name in changes if name not in known]
        if unknown:
            raise ConfigError(f"{', '.join(unknown)}: no such setting of a run; known are {', '.join(known)}")
        return replace(self, **changes)

    def resolved(self, recorded: Mapping[str, Any] | None = None) -> "RunSettings":
        """The same with nothing left open.

        Args:
            recorded: `config.json` of the run that is gone on with, if there is one; it fills what is open first.
        """
        names = ("workers", "lanes", "widths", "cores", "device", "precision")
        known = {name: recorded.get(name) for name in names} if recorded else {}
        lanes = self.lanes or known.get("lanes") or (1 if recorded else default_lanes(len(self.seeds)))
        workers = self.workers or known.get("workers") or (1 if lanes == 1 else default_players())
        processes = min(workers, len(self.seeds)) if lanes == 1 else 1
        cores = self.cores or known.get("cores") or max(1, usable_cores() // processes)
        device = self.device or known.get("device") or jax.default_backend()
        if self.precision == "tensorfloat32" and device != "gpu":
            raise ConfigError(f"precision: tensorfloat32 is a format of GPUs, this is a {device}; take float32")
        precision = self.precision or known.get("precision") or _precision_now()
        widths = self.widths or known.get("widths")
        if widths is not None and lanes == 1:
            raise ConfigError("widths: lanes are padded, and this run has none; leave it out, or ask for lanes")
        return replace(
            self, workers=workers, lanes=lanes, widths=widths, cores=cores, device=device, precision=precision
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types, as they stand in `config.json`."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        keep = self.keep_checkpoints
        return values | {
            "seeds": list(self.seeds),
            "keep_checkpoints": keep if keep == "all" else list(keep),
            "widths": None if self.widths is None else list(self.widths),
            "evaluate": None if self.evaluate is None else self.evaluate.to_dict(),
        }

    @classmethod
    def recorded(cls, config: Mapping[str, Any]) -> "RunSettings":
        """The settings in a `config.json`, but for the evaluation, which a record cannot bring back to life.

        Raises:
            ConfigError: a value is out of range, so the file was changed.
        """
        names = [field.name for field in fields(cls) if field.name in config and field.name != "evaluate"]
        values = {name: config[name] for name in names}
        if isinstance(keep := values.get("keep_checkpoints"), list):
            values["keep_checkpoints"] = tuple(keep)
        if values.get("widths") is not None:
            values["widths"] = tuple(values["widths"])
        return cls(**values)


def default_lanes(trainings: int) -> int:
    """Lanes of the program when nobody says: all trainings beside an accelerator, one on a processor."""
    return 1 if jax.default_backend() == "cpu" else trainings


def default_players() -> int:
    """Processes that play policies beside lanes when nobody says: on a processor none, training has the cores."""
    return 1 if jax.default_backend() == "cpu" else max(1, usable_cores() - 1)


def products_in(precision: Precision | None) -> contextlib.AbstractContextManager[object]:
    """A context whose matrix products have a run's precision, if this device has it; None leaves JAX as it is."""
    if precision is None or jax.default_backend() == "cpu":
        return contextlib.nullcontext()
    return jax.default_matmul_precision("highest" if precision_here(precision) == "float32" else "high")


def precision_here(precision: Precision | None) -> Precision:
    """The format of products on this device: a run that was begun on a GPU may be gone on with elsewhere."""
    return (precision or _precision_now()) if jax.default_backend() == "gpu" else "float32"


def named_precision(recorded: Any, device: str) -> Any:
    """The name of a precision in a record, which once held JAX's grades; what else stands there is left.

    Args:
        recorded: as it stands there.
        device: kind of device that it was recorded on.
    """
    if recorded in ("default", "high", "highest"):
        return "tensorfloat32" if device == "gpu" and recorded != "highest" else "float32"
    return recorded


def _precision_now() -> Precision:
    """float32 unless JAX was set to something: its own default on a GPU is TF32, for float32 numbers too."""
    named = jax.config.values["jax_default_matmul_precision"]
    if named is None:
        return "float32"
    device = jax.default_backend()
    if named not in _GRADES or (device == "tpu" and _GRADES[named] != "highest"):
        raise ConfigError(f"precision: JAX is set to {named!r}, which a run cannot record; take float32")
    return named_precision(_GRADES[named], device)


class SettingChanges(TypedDict, total=False):
    """The fields of `RunSettings` as keyword arguments, for `fit(..., steps=1000, seeds=[0, 1])`."""

    steps: int
    seeds: Sequence[int]
    evaluate: EvaluationSettings | None
    checkpoint_every: int
    keep_checkpoints: KeepCheckpoints
    stretch: int
    on_divergence: OnDivergence
    workers: int | None
    lanes: int | None
    widths: tuple[int, int] | None
    cores: int | None
    device: Device | None
    precision: Precision | None


def differences(old: Mapping[str, Any], new: Mapping[str, Any], more: Iterable[str] = ()) -> dict[str, str]:
    """In which fields that a run's directory belongs to two records differ, each in words.

    Args:
        old: content of `config.json`.
        new: the same of what was asked for.
        more: further fields to compare.
    """
    names, old = [*more, *_COMPARED], {"lanes": 1, **old}  # a run from before there were lanes
    return {name: _difference(name, old.get(name), new.get(name)) for name in names if old.get(name) != new.get(name)}


def _difference(field: str, old: Any, new: Any) -> str:
    if isinstance(old, dict) and isinstance(new, dict):
        keys = [key for key in {**old, **new} if old.get(key) != new.get(key)]
        return ", ".join(_difference(f"{field}.{key}", old.get(key), new.get(key)) for key in keys)
    return f"{field} was {old!r}, now {new!r}"
