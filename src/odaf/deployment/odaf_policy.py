"""Acts with a `policy.safetensors` that `odaf export` wrote. Needs NumPy and nothing else; runs no code of the file.

    policy = Policy("policy.safetensors")
    action = policy.act({"level": 1.2, "flow": 0.4})     # float32, in the order of policy.action_columns, within bounds

An observation is given by name, or as numbers in the order of `policy.columns`. What is missing, of another name, not a
number or not finite raises `Refused`, and leaves what the policy remembers as it was. Any byte order and any real type
of numbers is converted. `act` gives None while it has not seen the earlier steps that an action is made of: somebody
else has to act there, as after a guard has stopped it (`policy.status` is STOPPED, or ALARM after an alarm). Tell what
was played instead of its own action with `acted`; `begin` starts a new episode.

A program is a list of operations on float32 arrays of three axes: members of an ensemble, draws, columns.
"""

import hashlib
import json
import math
from collections.abc import Mapping

import numpy as np

FORMAT, VERSION = "odaf-artefact", "1"
FINE, NOT_FINITE, NOT_KNOWN, OVERFLOW, ALARM, STOPPED = range(6)  # the output `status`


class Refused(ValueError):
    """An observation that the policy gives no action for, or a file that is none of its kind."""


def _affine(x, weight, bias=None):
    product = np.matmul(x, weight)
    return product if bias is None else product + bias


def _standardise(x, epsilon):
    centred = x - x.mean(axis=2, keepdims=True)
    return centred / np.sqrt((centred * centred).mean(axis=2, keepdims=True) + x.dtype.type(epsilon))


def _best(values, candidates):
    place = int(np.argmax(values[0, :, 0]))
    return candidates[:, place : place + 1]


OPERATIONS = {
    "affine": _affine,
    "add": np.add,
    "subtract": np.subtract,
    "multiply": np.multiply,
    "divide": np.divide,
    "minimum": np.minimum,
    "maximum": np.maximum,
    "less": lambda a, b: (a < b).astype(a.dtype),
    "relu": lambda x: np.maximum(x, 0),
    "silu": lambda x: x / (1 + np.exp(-x)),
    "tanh": np.tanh,
    "exp": np.exp,
    "sqrt": np.sqrt,
    "absolute": np.absolute,
    "finite": lambda x: np.isfinite(x).astype(x.dtype),
    "standardise": _standardise,
    "concatenate": lambda *parts: np.concatenate(parts, axis=2),
    "slice": lambda x, first, last: x[:, :, first:last],
    "sum": lambda x, axis: x.sum(axis=axis, keepdims=True),
    "mean": lambda x, axis: x.mean(axis=axis, keepdims=True),
    "smallest": lambda x, axis: x.min(axis=axis, keepdims=True),
    "largest": lambda x, axis: x.max(axis=axis, keepdims=True),
    "best": _best,
    "select": lambda condition, a, b: np.where(condition != 0, a, b),
}


class Policy:
    """One policy and what it remembers of the episode it is in."""

    def __init__(self, file, dtype: type = np.float32):
        arrays, text = read(file)
        program = json.loads(text)
        self.inputs = {entry["name"]: entry["columns"] for entry in program["inputs"]}
        self.outputs = {entry["name"]: entry for entry in program["outputs"]}
        self.columns = program["inputs"][0]["columns"]
        self.units = dict(zip(self.columns, program["inputs"][0]["units"], strict=False))
        self.action_columns = self.outputs["action"]["columns"] if "action" in self.outputs else []
        self._carries, self._dtype = program["carries"], dtype
        self._constants = {name: array.astype(dtype) for name, array in arrays.items()}
        self.steps = [
            (OPERATIONS[kind], result, arguments, attributes)
            for kind, result, arguments, attributes in program["operations"]
        ]
        self.begin()

    def begin(self):
        """Starts an episode: nothing is remembered."""
        self._carry = {
            carry["name"]: np.array(
                [math.nan if value is None else value for value in carry["start"]], self._dtype
            ).reshape(1, 1, -1)
            for carry in self._carries
        }

    def act(self, observation):
        """The action [act_dim]; None where the steps before are not known yet."""
        found = self.step({next(iter(self.inputs)): observation})
        if self.status == OVERFLOW:
            raise Refused("observation: lies so far out that no number holds the action; check its units")
        return None if self.status in (NOT_KNOWN, STOPPED) else found["action"]

    def acted(self, action):
        """Tells what was played in the last step, if it was not what `act` gave."""
        played = self.row("action", action, self.action_columns)
        for carry in self._carries:
            if carry["of"] == "action":
                later = self._carry[carry["name"]][:, :, len(played) :]
                self._carry[carry["name"]] = np.concatenate([played.reshape(1, 1, -1), later], axis=2)

    def step(self, inputs):
        """Every output of one step by its name, from {input: observation}."""
        rows = {name: self.row(name, inputs[name], columns, False) for name, columns in self.inputs.items()}
        found = self.run(rows)  # a guard takes note of what is not finite, too
        _ = [_finite(name, rows[name], columns) for name, columns in self.inputs.items()]
        return found

    def run(self, rows):
        """As `step`, of numbers that nobody has looked at: where `status` is not 0, they are refused by the program."""
        values = {**self._constants, **self._carry}
        for name, row in rows.items():
            values[name] = np.asarray(row, self._dtype).reshape(1, 1, -1)
        with np.errstate(all="ignore"):
            for function, result, arguments, attributes in self.steps:
                values[result] = function(*[values[name] for name in arguments], **attributes)
        self._carry = {carry["name"]: values[carry["next"]] for carry in self._carries}
        found = {name: values[entry["value"]].reshape(-1) for name, entry in self.outputs.items()}
        self.status = int(found["status"][0]) if "status" in found else FINE
        return found

    def row(self, what, given, columns, finite=True):
        if isinstance(given, Mapping):
            missing = [name for name in columns if name not in given]
            unknown = [name for name in given if name not in columns]
            if missing or unknown:
                lacks = f"missing {missing or 'none'}, unknown {unknown or 'none'}"
                raise Refused(f"{what}: {lacks}; give exactly {', '.join(columns)}")
            given = [_number(what, name, given[name]) for name in columns]
        numbers = _numbers(what, given).reshape(-1)
        if len(numbers) != len(columns):
            raise Refused(f"{what}: holds {len(numbers)} numbers, but takes {len(columns)}: {', '.join(columns)}")
        with np.errstate(over="ignore"):
            numbers = numbers.astype(np.float32)
        return _finite(what, numbers, columns) if finite else numbers


def _finite(what, numbers, columns):
    if not np.isfinite(numbers).all():
        name = columns[int(np.argmin(np.isfinite(numbers)))]
        raise Refused(f"{what}: {name} is not a finite number; replace it before the call")
    return numbers


def _number(what, name, value):
    number = _numbers(f"{what}: {name}", value)
    if number.size != 1:
        raise Refused(f"{what}: {name}: holds {number.size} numbers, but takes one")
    return number.reshape(())


def _numbers(what, value):
    """Real numbers in the machine's byte order; what is masked becomes NaN."""
    try:
        array = np.ma.asarray(value) if isinstance(value, np.ma.MaskedArray) else np.asarray(value)
    except ValueError as error:
        raise Refused(f"{what}: holds no numbers in a row ({error})") from None
    if array.dtype.kind not in "bfiu":
        raise Refused(f"{what}: {value!r:.60} is no number")
    return (
        np.ma.filled(array.astype(np.float64), math.nan) if array.dtype.kind != "f" else np.ma.filled(array, math.nan)
    )


def read(file):
    """The arrays of a file in the layout of safetensors, and the program in its header; both checked by their sum."""
    with open(file, "rb") as opened:
        content = opened.read()
    try:
        length = int.from_bytes(content[:8], "little")
        header = json.loads(content[8 : 8 + length])
        metadata, data = header.pop("__metadata__"), content[8 + length :]
        arrays = {}
        for name, entry in sorted(header.items()):
            begin, end = entry["data_offsets"]
            arrays[name] = np.frombuffer(data[begin:end], "<f4").reshape(entry["shape"])
        digest = hashlib.sha256(metadata["program"].encode())
        for _, array in sorted(arrays.items()):
            digest.update(array.tobytes())
    except (ValueError, KeyError, AttributeError, TypeError) as error:
        raise Refused(f"{file}: is damaged, or no file of `odaf export` ({error!r})") from None
    if (metadata.get("format"), metadata.get("version")) != (FORMAT, VERSION):
        raise Refused(f"{file}: is {metadata.get('format')} {metadata.get('version')}, expected {FORMAT} {VERSION}")
    if digest.hexdigest() != metadata.get("sha256"):
        raise Refused(f"{file}: was changed after it was written")
    return arrays, metadata["program"]
