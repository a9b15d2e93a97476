"""Schema of glTF documents: the type of every field that is read later is checked here.

glTF libraries coerce wrong values (`"5"` to 5, 1.5 to 1) or fail deep inside; here the message names the field. Source: the
glTF 2.0 specification of the Khronos Group, section 5.
"""

import math
from collections.abc import Callable
from typing import Any

from riginv.errors import InputError

Document = dict[str, Any]


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**53


def _number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 2**1000 and math.isfinite(value)


Check = tuple[Callable[[Any], bool], str]
WHOLE: Check = (_whole, "a whole number of at least 0")
NUMBER: Check = (_number, "a finite number")
TEXT: Check = (lambda value: isinstance(value, str), "a text")
FLAG: Check = (lambda value: isinstance(value, bool), "true or false")
ANYTHING: Check = (lambda value: True, "anything")
OBJECT: Check = (lambda value: isinstance(value, dict), "an object {...}")

EACH = "*"  # in a schema: any other key
ATTRIBUTES = {EACH: WHOLE}
TARGET = {"extras": ANYTHING, "extra": ANYTHING, EACH: WHOLE}  # `extra` is how UniVRM named targets
# Field -> a check, a list with the schema of its elements, or a dict of fields; a name ending in ! is required.
DOCUMENT: Document = {
    "asset!": {"version!": TEXT},
    "extensionsUsed": [TEXT],
    "extensionsRequired": [TEXT],
    "scene": WHOLE,
    "scenes": [{"nodes": [WHOLE]}],
    "nodes": [
        {
            "name": TEXT,
            "children": [WHOLE],
            "mesh": WHOLE,
            "skin": WHOLE,
            "matrix": [NUMBER],
            "translation": [NUMBER],
            "rotation": [NUMBER],
            "scale": [NUMBER],
            "weights": [NUMBER],
        }
    ],
    "meshes": [
        {
            "name": TEXT,
            "weights": [NUMBER],
            "extras": ANYTHING,
            "primitives!": [
                {
                    "attributes!": ATTRIBUTES,
                    "indices": WHOLE,
                    "mode": WHOLE,
                    "targets": [TARGET],
                    "extensions": OBJECT,
                    "extras": ANYTHING,
                }
            ],
        }
    ],
    "skins": [{"name": TEXT, "joints!": [WHOLE], "inverseBindMatrices": WHOLE}],
    "animations": [
        {
            "name": ANYTHING,
            "channels!": [{"sampler!": WHOLE, "target!": {"node": WHOLE, "path!": TEXT, "extensions": OBJECT}}],
            "samplers!": [{"input!": WHOLE, "output!": WHOLE, "interpolation": TEXT}],
        }
    ],
    "accessors": [
        {
            "name": ANYTHING,
            "bufferView": WHOLE,
            "byteOffset": WHOLE,
            "componentType!": WHOLE,
            "normalized": FLAG,
            "count!": WHOLE,
            "type!": TEXT,
            "sparse": {
                "count!": WHOLE,
                "indices!": {"bufferView!": WHOLE, "byteOffset": WHOLE, "componentType!": WHOLE},
                "values!": {"bufferView!": WHOLE, "byteOffset": WHOLE},
            },
        }
    ],
    "bufferViews": [
        {"buffer!": WHOLE, "byteOffset": WHOLE, "byteLength!": WHOLE, "byteStride": WHOLE, "extensions": OBJECT},
    ],
    "buffers": [{"uri": TEXT, "byteLength!": WHOLE}],
}


def checked_document(raw: Any, path: Any) -> Document:
    """The fields of a glTF document that are read, with their types checked; null counts as absent.

    Args:
        raw: the parsed JSON.
        path: of the file, for messages.

    Raises:
        InputError: a field is missing or has the wrong type; the message names it.
    """
    return _checked(raw, DOCUMENT, str(path), "the document")


def _checked(value: Any, expected: Any, path: str, where: str) -> Any:
    if isinstance(expected, tuple):
        holds, words = expected
        if not holds(value):
            raise InputError(f"{path}: {where} is {_shown(value)}, expected {words}: the file is damaged; export it again")
        return value
    if isinstance(expected, list):
        if not isinstance(value, list):
            raise InputError(f"{path}: {where} is {_shown(value)}, expected a list: the file is damaged; export it again")
        return [_checked(item, expected[0], path, f"{where}[{number}]") for number, item in enumerate(value)]
    if not isinstance(value, dict):
        raise InputError(f"{path}: {where} is {_shown(value)}, expected an object: the file is damaged; export it again")
    result: dict[str, Any] = {}
    for key, inner in expected.items():
        if key == EACH:
            others = {name: item for name, item in value.items() if name not in expected}
            return result | {name: _checked(item, inner, path, f"{where}.{name}") for name, item in others.items()}
        name = key.removesuffix("!")
        found = value.get(name)
        if found is not None:
            result[name] = _checked(found, inner, path, name if expected is DOCUMENT else f"{where}.{name}")
        elif key.endswith("!"):
            raise InputError(f"{path}: {where} has no '{name}', which glTF 2.0 requires: the file is damaged; export it again")
    return result


def _shown(value: Any) -> str:
    try:
        text = repr(value)
    except ValueError:  # an integer of thousands of digits
        text = "a huge number"
    return text if len(text) <= 40 else f"{text[:37]}..."
