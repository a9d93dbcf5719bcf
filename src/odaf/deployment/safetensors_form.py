"""A program in the layout of safetensors, beside the one file that runs it with NumPy alone."""

import hashlib
import json
from pathlib import Path

import odaf
from odaf.deployment.odaf_policy import FORMAT, VERSION
from odaf.deployment.program import Program
from odaf.training.tensors import write_tensors

RUNNER = Path(__file__).with_name("odaf_policy.py")


def write_safetensors(program: Program, path: Path) -> None:
    """The constants as arrays, and everything else as JSON in the metadata of the header.

    Raises:
        CheckpointError: the file cannot be written.
    """
    arrays = dict(sorted(program.constants.items()))
    text = json.dumps(program.to_dict(), separators=(",", ":"), allow_nan=False)
    digest = hashlib.sha256(text.encode())
    for array in arrays.values():
        digest.update(array.astype("<f4").tobytes())
    metadata = {
        "format": FORMAT,
        "version": VERSION,
        "odaf": odaf.__version__,
        "sha256": digest.hexdigest(),
        "program": text,
    }
    write_tensors(path, arrays, metadata)
