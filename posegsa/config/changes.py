"""Changes of values, by their paths, in the data of an experiment."""

from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

from posegsa.config.filter_config import BELIEF_ALSO, FILTERS
from posegsa.config.schedule_config import fitted_bounds
from posegsa.optimisers import OPTIMISERS, Optimiser
from posegsa.settings.violations import Violation


def with_values(
    data: dict[str, Any], before: Optimiser, values: Iterable[tuple[str, object]]
) -> tuple[dict[str, Any], list[Violation]]:
    """The data of an experiment with values replaced, and the values that cannot be.

    Args:
        data: Plain data of a whole experiment; changed in place.
        before: The optimiser of the experiment before the changes.
        values: Paths of keys and array indices, such as `scenario.vectors.0.noise`, or of a whole
            section, each with its value.
    """
    range_before = data["parameters"].get("gain_range")
    filter_before = dict(data.get("filter", {}))
    data["search"], named, violations = {}, [], []
    for path, value in values:
        named.append(path)
        plain = value.model_dump(mode="json") if isinstance(value, BaseModel) else value
        if violation := _set(data, path, plain):
            violations.append(violation)
    if isinstance(data["search"], dict):
        data["search"] = _search(before, data["search"])
    parameters = data["parameters"]
    filter_ = data.get("filter")
    if isinstance(filter_, dict) and filter_.get("kind") != filter_before.get("kind"):
        # The numbers of one kind of filter have no meaning for another.
        _leave_named(data, "filter", named)
        _leave_named(data, "tuned", named)
        if not _named("parameters.also", named):
            # The data hold every value, so it is not known which of them the user set.
            kind = FILTERS.get(str(filter_.get("kind")))
            also = () if kind is None else kind.also
            parameters["also"] = [one.model_dump(mode="json") for one in also]
    elif isinstance(filter_, dict) and filter_.get("schedule") != filter_before.get("schedule"):
        _leave_named(data, "tuned", named)
        if filter_.get("schedule") == "constant" and not _named("parameters.also", named):
            parameters["also"] = [
                one for one in parameters["also"] if not one["key"].startswith("gain.")
            ]
    if range_before and "parameters.gain_range" in named and isinstance(parameters, dict):
        for key, fitted in fitted_bounds(*range_before).items():
            # Refit bounds that were fitted to the old range and are not set by the user.
            stated = _named(f"parameters.{key}", named)
            if not stated and tuple(parameters[key]) == fitted:
                del parameters[key]
    if not _named("parameters.also", named):
        # A number that is set is not tuned any more.
        parameters["also"] = [one for one in parameters["also"] if not _named(one["key"], named)]
        # Nor is a number of a schedule that is switched off.
        if isinstance(filter_, dict):
            roles = ("unknown", "belief")
            gone = [role for role in roles if filter_.get(role) == "off" != filter_before.get(role)]
            begins = tuple(f"filter.{role}_" for role in gone)
            parameters["also"] = [x for x in parameters["also"] if not x["key"].startswith(begins)]
            parameters["also"] += _of_belief(filter_, filter_before, named)
    return data, violations


def _of_belief(
    filter_: Mapping[str, Any], before: Mapping[str, Any], named: Iterable[str]
) -> list[dict[str, Any]]:
    """What is tuned too by default if changes switch on an observer's belief."""
    kind, off = filter_.get("kind"), "off"
    was = before.get("belief", off) != off and before.get("kind") == kind
    if kind != "observer" or was or filter_.get("belief", off) == off:
        return []
    return [one.model_dump(mode="json") for one in BELIEF_ALSO if not _named(one.key, named)]


def _leave_named(data: dict[str, Any], section: str, named: list[str]) -> None:
    """Remove all keys from a section that the changes do not name: they get their defaults."""
    if isinstance(table := data.get(section), dict):
        kept = {key: value for key, value in table.items() if _named(f"{section}.{key}", named)}
        data[section] = kept


def _named(key: str, named: Iterable[str]) -> bool:
    """Whether the changes name a key, a table that contains it, or a key inside it."""
    return any(f"{one}.".startswith(f"{key}.") or f"{key}.".startswith(f"{one}.") for one in named)


def _search(before: Optimiser, named: dict[str, Any]) -> dict[str, Any]:
    """The table [search] after some of its values were given."""
    kind = OPTIMISERS.get(str(named.get("optimiser")), type(before))
    if kind is type(before):
        return before.model_dump(mode="json") | named
    if not (before.wants_gradients or kind.wants_gradients):
        return {"agents": before.agents, "iterations": before.iterations} | named
    if "iterations" in named:
        return named
    try:
        return kind.model_validate(named).within(before.evaluations).model_dump(mode="json")
    except ValidationError:
        return named  # refused later, with all other errors


def _set(data: dict[str, Any], path: str, value: object) -> Violation | None:
    """Change one value of the data in place, or return why that is not possible."""
    keys = path.split(".")
    node: Any = data
    for depth, name in enumerate(keys):
        key: Any = name
        if isinstance(node, list) and name in map(str, range(len(node))):
            key = int(name)
        elif not isinstance(node, dict):
            kind = f"an array of {len(node)}" if isinstance(node, list) else "a single value"
            return Violation(path, f"{'.'.join(keys[:depth])} is {kind}; it has no {key}", value)
        if depth == len(keys) - 1:
            node[key] = value
        elif isinstance(node, dict):
            node = node.setdefault(key, {})  # a new key is unknown, and is reported as such
        else:
            node = node[key]
    return None
