"""Published files and what their names promise: is this the file, and which published scores may it be laid beside?"""

import hashlib
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass

from odaf.data.checks.findings import Finding
from odaf.data.log import Log


@dataclass(frozen=True)
class Published:
    """Size and SHA-256 of a published file."""

    name: str
    size: int
    sha256: str


PUBLISHED = (
    Published(
        "hopper-medium-replay-v2", 75_854_457, "e121c5f7c9857a307baa9edc6a2c3b48e85fedb9ac316ecddd0f48ca7ef4e39b"
    ),
    Published(
        "walker2d-medium-replay-v2", 86_323_963, "e75de96a4f77acf7d4e0d6fdf0d7ccb177c26c44bb4388e4fd99f543ccfa18db"
    ),
)


def file_findings(path: str | os.PathLike[str]) -> list[Finding]:
    """Compares a file with the published one of its name, if one is known."""
    stem = os.path.basename(os.fspath(path)).lower().replace("_", "-")
    entry = next((entry for entry in PUBLISHED if stem in (f"{entry.name}.hdf5", f"{entry.name}.h5")), None)
    if entry is None or not os.path.isfile(path):
        return []
    size = os.path.getsize(path)
    if size != entry.size:
        return [_differs(f"has {size:,} bytes, the published {entry.name} has {entry.size:,}")]
    digest = file_sha256(path)
    if digest != entry.sha256:
        return [_differs(f"has SHA-256 {digest[:12]}..., the published {entry.name} has {entry.sha256[:12]}...")]
    return [Finding("known-file", "note", "", 1, (), f"is the published {entry.name}, byte for byte", "nothing to do")]


def version_findings(log: Log) -> list[Finding]:
    """Why scores on this log may not be laid beside published tables."""
    name = _name(log)
    why = ""
    if log.format == "minari" and "mujoco" in name:
        why = "Minari's MuJoCo sets come from other policies in version 5 of the environments"
    elif re.search(r"[-_]v0\b", name) and log.format == "d4rl":
        why = "this is version 0 of the data; the tables of the literature are mostly on version 2"
    elif log.format == "d4rl" and "max_episode_steps" in log.provenance:  # asked for where the file has no time-outs
        why = "a D4RL file without time-outs is of version 0; the tables of the literature are mostly on version 2"
    if not why:
        return []
    return [
        Finding(
            "other-version", "warning", "", 1, (), why,
            "do not compare its scores with tables of the other version; name the data's version beside each score",
        )
    ]  # fmt: skip


def file_sha256(path: str | os.PathLike[str]) -> str:
    """SHA-256 (hex) of a file's bytes, read in pieces."""
    with open(path, "rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def _name(log: Log) -> str:
    facts = log.provenance.get("minari")
    identity = facts.get("dataset_id", "") if isinstance(facts, Mapping) else ""
    return f"{log.source} {log.provenance.get('file', '')} {identity}".lower()


def _differs(message: str) -> Finding:
    return Finding(
        "known-file-differs", "warning", "", 1, (), message,
        "copy the file again, or rename it if it was changed on purpose: its scores are not those of the published one",
    )  # fmt: skip
