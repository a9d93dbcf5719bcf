"""Whether a record says what today's code would measure, and if not, which field differs.

An identity is a nested table. A field that a record does not state, because it was added later, counts as what held
before: a learner's own default, or what the work declares (`Work.unrecorded`). A field of a learner that was renamed
or removed, or added with a default that is not what held before, needs an entry in `MIGRATIONS`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from odaf.errors import ConfigError

LEARNER_VERSIONS: dict[str, int] = {"ensemble-sac": 1, "behaviour-cloning": 1}
"""By kind: raised when the same settings train another policy, by more than the rounding of sums. Others have 1."""


@dataclass(frozen=True)
class Migration:
    """A change of a learner's fields that leaves what old records measured as it was.

    Attributes:
        kind: the learner, as configurations name it.
        field: its name, dotted; of two the old one. A term's field begins with the term's name.
        what: "renamed"; "removed"; or "added", where the learner's default is not what held before.
        value: its new name in the same place; the value at which it could go, a record with another one stays stale,
            or `ANY` where it never did anything; what held before there was a setting.
    """

    kind: str
    field: str
    what: Literal["renamed", "removed", "added"]
    value: Any


ANY = object()

MIGRATIONS: tuple[Migration, ...] = (
    Migration("behaviour-cloning", "discount", "removed", ANY),
    Migration("behaviour-cloning", "normaliser_epsilon", "added", 1e-3),
    Migration("ensemble-sac", "normaliser_epsilon", "added", 1e-3),
)


def todays_learner(recorded: Mapping[str, Any], migrations: Sequence[Migration] | None = None) -> dict[str, Any] | str:
    """The settings of a record as today's code states them, new fields filled in; or why it cannot read them."""
    from odaf.algorithms import config
    from odaf.training.files import plain

    fields = plain(recorded)
    for migration in MIGRATIONS if migrations is None else migrations:
        if migration.kind == fields.get("kind"):
            _apply(migration, fields)
    try:
        return by_name(config.to_dict(config.from_dict(fields, "the record")))
    except ConfigError as error:
        return str(error)


def by_name(settings: Mapping[str, Any]) -> dict[str, Any]:
    """A learner's settings with its list of terms as a table, so that a difference can name the term."""
    from odaf.training.files import plain

    return {
        name: {term["name"]: {**term} for term in value} if name == "terms" else value
        for name, value in plain(settings).items()
    }


def differences(
    recorded: Mapping[str, Any], today: Mapping[str, Any], unrecorded: Mapping[str, Any] | None = None
) -> list[str]:
    """Every field that differs, as in "learner.discount was 0.99, is 0.995"; none if the record counts.

    Args:
        recorded: the identity that the record states.
        today: the identity that today's code has.
        unrecorded: by dotted name, what held for records that do not state a field of today's.
    """
    from odaf.training.files import plain

    return _differences(plain(recorded), plain(today), plain(unrecorded or {}), "")


def _differences(
    old: Mapping[str, Any], new: Mapping[str, Any], unrecorded: Mapping[str, Any], before: str
) -> list[str]:
    found: list[str] = []
    for name in {**new, **old}:
        where = f"{before}{name}"
        if isinstance(new.get(name), Mapping) and isinstance(old.get(name, {}), Mapping):
            found += _differences(old.get(name, {}), new[name], unrecorded, f"{where}.")
        elif name not in new:
            found.append(f"{where} was {_shown(old[name])}, is no longer there")
        elif name not in old:
            if where not in unrecorded:
                found.append(f"{where} is {_shown(new[name])}, was not recorded")
            elif unrecorded[where] != new[name]:
                found.append(f"{where} was {_shown(unrecorded[where])}, is {_shown(new[name])}")
        elif old[name] != new[name]:
            found.append(f"{where} was {_shown(old[name])}, is {_shown(new[name])}")
    return found


def _shown(value: Any) -> str:
    text = "a table" if isinstance(value, Mapping) else repr(value)
    return text if len(text) <= 100 else f"{text[:97]}..."


def _apply(migration: Migration, fields: dict[str, Any]) -> None:
    *path, name = migration.field.split(".")
    place: Any = fields
    terms = {term["name"]: term for term in fields.get("terms", ())}
    for part in path:
        place = terms.get(part, place.get(part)) if place is fields else place.get(part)
        if not isinstance(place, dict):
            return
    if migration.what == "added":
        place.setdefault(name, migration.value)
    elif name in place and migration.what == "renamed":
        place[migration.value] = place.pop(name)
    elif name in place and migration.value in (ANY, place[name]):
        del place[name]
