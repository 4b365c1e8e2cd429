"""Fields of a YAML file: what they must be, or one clear error that names where, what there is and what comes near."""

import difflib
import math


def known(given, allowed, where: str) -> None:
    """Raise ValueError where ``given`` has a name that is not ``allowed``, with the names that come near it."""
    for name in given:
        if name not in allowed:
            raise ValueError(f"{where}: unknown {name}{near(name, allowed)}")


def near(name, allowed) -> str:
    """"; did you mean a or b?", or else the list of what there is."""
    close = difflib.get_close_matches(str(name), [str(one) for one in allowed], n=2)
    there = ", ".join(map(str, sorted(allowed))) or "none"
    return f"; did you mean {' or '.join(close)}?" if close else f"; there are {there}"


def vector(thing: dict, key: str, count: int, where: str) -> list[float]:
    """``count`` finite numbers under the key."""
    value = thing.get(key)
    values = value if isinstance(value, list | tuple) else [value]
    numbers = all(isinstance(x, int | float) and not isinstance(x, bool) and math.isfinite(x) for x in values)
    if len(values) != count or not numbers:
        raise ValueError(f"{where}: {key} must be {count} finite number{'s' if count > 1 else ''}, not {value!r}")
    return [float(x) for x in values]


def positive(thing: dict, key: str, count: int, where: str) -> list[float]:
    """``count`` numbers above zero under the key."""
    values = vector(thing, key, count, where)
    if min(values) <= 0:
        raise ValueError(f"{where}: {key} must be positive, not {thing[key]!r}")
    return values


def direction(thing: dict, key: str, where: str) -> list[float]:
    """Three numbers that are not all zero."""
    values = vector(thing, key, 3, where)
    if not any(values):
        raise ValueError(f"{where}: {key} must have a direction, not {thing[key]!r}")
    return values


def mappings(data: dict, key: str, where: str) -> list[dict]:
    """The list of mappings under ``key``; empty where there is none."""
    value = data.get(key, [])
    if not isinstance(value, list) or not all(isinstance(entry, dict) for entry in value):
        raise ValueError(f"{where}: {key} must be a list of mappings, not {value!r}")
    return value
