"""DNA files whose bytes are in order and whose numbers are not: other values in the arrays of any layer."""

import dataclasses
from typing import Any

import numpy as np

from rigs.dna.format import DnaFile
from rigs.dna.format.ragged import Ragged

INTEGERS = (0, 1, 2, 3, 7, 255, 65_535)
REALS = (0.0, -1.0, 1.0, 1e-30, 1e30, -1e38, np.nan, np.inf, -0.5, 2.0)


def mutated(file: DnaFile, random: np.random.Generator) -> DnaFile:
    """The file with one to three arrays of its layers changed."""
    layers = list(file.layers)
    known = [number for number, layer in enumerate(layers) if not isinstance(layer.content, bytes)]
    for _ in range(int(random.integers(1, 4))):
        number = int(random.choice(known))
        layers[number] = dataclasses.replace(layers[number], content=_changed(layers[number].content, random))
    return dataclasses.replace(file, layers=tuple(layers))


def _changed(value: Any, random: np.random.Generator) -> Any:
    """A value with a change somewhere in it."""
    if dataclasses.is_dataclass(value):
        name = str(random.choice([field.name for field in dataclasses.fields(value)]))
        return dataclasses.replace(value, **{name: _changed(getattr(value, name), random)})
    if isinstance(value, Ragged):
        return Ragged(_of_same_length(value.values, random), value.sizes)
    if isinstance(value, np.ndarray):
        return _array(value, random)
    if isinstance(value, tuple):
        if not value:
            return value
        index = int(random.integers(len(value)))
        if random.random() < 0.2 and not isinstance(value[0], Ragged):
            return value[:index] + value[index + 1 :]
        return (*value[:index], _changed(value[index], random), *value[index + 1 :])
    if isinstance(value, str):
        return str(random.choice(["", "a", value * 2, "\udcff", "\x1b[2J", "x.w"]))
    if value is None or isinstance(value, int):
        return None if value is None else int(random.choice([0, 1, 2, 5, 255]))
    return np.float32(random.choice(REALS))


def _array(values: np.ndarray, random: np.random.Generator) -> np.ndarray:
    if random.random() < 0.3:
        return values[: int(random.integers(len(values) + 1))]
    return _of_same_length(values, random)


def _of_same_length(values: np.ndarray, random: np.random.Generator) -> np.ndarray:
    changed = values.copy()
    if len(changed):
        places = random.integers(0, len(changed), max(1, int(random.integers(1 + len(changed) // 8))))
        changed[places] = random.choice(REALS if changed.dtype.kind == "f" else INTEGERS, len(places))
    return changed
