"""What a sketch file holds, and the check that a file holds just that.

SCHEMA is written in JSON Schema's words; the few that it uses are all that ``validate`` knows. Stricter:
no keys beside the named ones, numbers finite, strings of at most 200 characters.
"""

import math

KINDS = ("motion", "keep_out", "arrow")
HOLDS = ("keep", "down", "along")
MAX_POINTS = 200_000

_NUMBER = {"type": "number"}
ORIENTATION = {
    "type": "object",
    "required": ["kind"],
    "properties": {"kind": {"enum": list(HOLDS)}, "axis": {"type": "array", "shape": [3], "items": _NUMBER}},
}
SCHEMA = {
    "type": "object",
    "required": ["schema", "version", "sketches"],
    "properties": {
        "schema": {"enum": ["scene2skill.sketches"]},
        "version": {"enum": [1]},
        "sketches": {
            "type": "array",
            "maxItems": 100,
            "items": {
                "type": "object",
                "required": ["view", "camera", "strokes"],
                "properties": {
                    "view": {"type": "string"},
                    "camera": {
                        "type": "object",
                        "required": ["K", "world_from_camera", "width", "height"],
                        "properties": {
                            "K": {"type": "array", "shape": [3, 3], "items": _NUMBER},
                            "world_from_camera": {"type": "array", "shape": [4, 4], "items": _NUMBER},
                            "width": {"type": "integer"},
                            "height": {"type": "integer"},
                        },
                    },
                    "orientation": ORIENTATION,
                    "strokes": {
                        "type": "array",
                        "maxItems": 1000,
                        "items": {
                            "type": "object",
                            "required": ["points", "times"],
                            "properties": {
                                "points": {"type": "array", "shape": [None, 2], "items": _NUMBER},
                                "times": {"type": "array", "shape": [None], "items": _NUMBER},
                                "demonstration": {"type": "integer"},
                                "kind": {"enum": list(KINDS)},
                                "events": {
                                    "type": "array",
                                    "maxItems": 1000,
                                    "items": {
                                        "type": "object",
                                        "required": ["name", "time"],
                                        "properties": {"name": {"type": "string"}, "time": _NUMBER},
                                    },
                                },
                                "pressure": {"type": "array", "shape": [None], "items": _NUMBER},
                                "pointer": {"type": "string"},
                            },
                        },
                    },
                },
            },
        },
    },
}
"""``shape`` is ours: the sizes of nested arrays of numbers, None for any size up to MAX_POINTS."""


_TYPES = {"object": dict, "array": list, "string": str, "integer": int, "number": (int, float)}


def validate(value, schema: dict = SCHEMA, where: str = "") -> None:
    """Raise ValueError at the first place where ``value`` is not what ``schema`` (a part of SCHEMA) says."""
    if "enum" in schema:
        if value not in schema["enum"] or isinstance(value, bool):
            raise ValueError(f"{where or 'the file'} is {str(value)[:40]!r}: expected one of {schema['enum']}")
        return
    kind = schema["type"]
    if not isinstance(value, _TYPES[kind]) or isinstance(value, bool):
        raise ValueError(f"{where or 'the file'} must be of type {kind}, not {type(value).__name__}")
    if kind == "object":
        _validate_object(value, schema, where)
    elif kind == "array" and "shape" in schema:
        _validate_numbers(value, schema["shape"], where)
    elif kind == "array":
        if len(value) > schema["maxItems"]:
            raise ValueError(f"{where} has {len(value)} items: at most {schema['maxItems']} are allowed")
        for i, item in enumerate(value):
            validate(item, schema["items"], f"{where}[{i}]")
    elif kind == "string" and len(value) > 200:
        raise ValueError(f"{where} has {len(value)} characters: at most 200 are allowed")
    elif kind in ("number", "integer") and not _finite(value):
        raise ValueError(f"{where} is {str(value)[:40]}: a finite number is needed")


def _validate_object(value: dict, schema: dict, where: str) -> None:
    prefix = f"{where}." if where else ""
    for key in schema["required"]:
        if key not in value:
            raise ValueError(f"{prefix}{key} is missing")
    for key, item in value.items():
        if key not in schema["properties"]:
            raise ValueError(f"{prefix}{key[:40]} is unknown: known are {', '.join(schema['properties'])}")
        validate(item, schema["properties"][key], f"{prefix}{key}")


def _validate_numbers(value, shape: list, where: str) -> None:
    if not isinstance(value, list) or (len(value) != shape[0] if shape[0] is not None else len(value) > MAX_POINTS):
        expected = f"{shape[0]}" if shape[0] is not None else f"at most {MAX_POINTS}"
        found = f"{len(value)}" if isinstance(value, list) else f"a {type(value).__name__}"
        raise ValueError(f"{where} must be a list of {expected} items, not {found}")
    if len(shape) > 1:
        for i, row in enumerate(value):
            _validate_numbers(row, shape[1:], f"{where}[{i}]")
        return
    for i, number in enumerate(value):
        if type(number) not in (int, float) or not _finite(number):  # bool is an int, but not here
            raise ValueError(f"{where}[{i}] is {str(number)[:40]}: a finite number is needed")


def _finite(number) -> bool:
    try:
        return math.isfinite(float(number))
    except OverflowError:  # an integer of hundreds of digits
        return False
