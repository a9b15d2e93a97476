"""Numbers in a config that cannot be meant: said before any work starts."""

import math
from collections.abc import Callable
from fnmatch import fnmatch
from typing import Any

from riginv.errors import InputError

Check = tuple[str, Callable[[Any], bool]]

AT_LEAST_1: Check = ("a whole number of at least 1", lambda value: _is_whole(value) and value >= 1)
AT_LEAST_0: Check = ("a whole number of at least 0", lambda value: _is_whole(value) and value >= 0)
POSITIVE: Check = ("a finite number above 0", lambda value: _is_number(value) and value > 0)
NOT_NEGATIVE: Check = ("a finite number of at least 0", lambda value: _is_number(value) and value >= 0)
WIDTHS: Check = (
    "a list of whole numbers of at least 1",
    lambda value: isinstance(value, list) and all(AT_LEAST_1[1](v) for v in value),
)
WHOLE: Check = ("a whole number", lambda value: _is_whole(value))
BOOLEAN: Check = ("true or false", lambda value: isinstance(value, bool))
TEXT: Check = ("a path or a URL", lambda value: isinstance(value, str) and value != "")

# Key in the resolved config (with wildcards) -> what it must be; null is allowed where a default says so.
RULES: dict[str, Check] = {
    "seed": AT_LEAST_0,
    "resume": BOOLEAN,
    "refine": AT_LEAST_0,
    "poses": AT_LEAST_1,
    "stop_below_lr": POSITIVE,
    "data.store": TEXT,
    "data.*": AT_LEAST_1,
    "samples": AT_LEAST_1,
    "chunk": AT_LEAST_1,
    "vertices": BOOLEAN,
    "recheck": BOOLEAN,
    "dtype": ("float32 or float16", lambda value: value in ("float32", "float16")),
    "mesh_space.samples": AT_LEAST_1,
    "*residual_mm": POSITIVE,
    "methods.*.smoothness": NOT_NEGATIVE,
    "methods.*.prior": NOT_NEGATIVE,
    "methods.*.sparsity": NOT_NEGATIVE,
    "methods.*.blur": NOT_NEGATIVE,
    "methods.*.lr": POSITIVE,
    "methods.*.variance": POSITIVE,
    "methods.*starts": AT_LEAST_1,
    "methods.*.descent_steps": AT_LEAST_0,
    "methods.*.more_steps": AT_LEAST_0,
    "methods.*.mean_steps": AT_LEAST_0,
    **dict.fromkeys((f"methods.*.{key}" for key in ("pairs", "triples", "quadruples")), AT_LEAST_0),
    **dict.fromkeys((f"methods.*.{key}" for key in ("clusters", "drawn", "poses", "iterations", "batch_size")), AT_LEAST_1),
    "methods.*.knots": ("a whole number of at least 2", lambda value: _is_whole(value) and value >= 2),
    "methods.*steps": AT_LEAST_1,
    "judging.*": AT_LEAST_1,
    "noise_mm": POSITIVE,
    "noise.radius_mm": POSITIVE,
    "noise.*": NOT_NEGATIVE,
    "trainer.max_steps": AT_LEAST_1,
    "trainer.devices": AT_LEAST_1,
    "trainer.num_nodes": AT_LEAST_1,
    "trainer.precision": ("32-true, or bf16-mixed: what learns in bfloat16", lambda value: value in ("32-true", "bf16-mixed")),
    "trainer.compile": BOOLEAN,
    "trainer.threads": ("auto, or a whole number of at least 1", lambda value: value == "auto" or AT_LEAST_1[1](value)),
    "trainer.starts_processes": BOOLEAN,
    "trainer.log_every_n_steps": AT_LEAST_1,
    "model.cpu_steps": AT_LEAST_1,
    "surrogate.cpu_steps": AT_LEAST_1,
    "model.optimizer.lr": POSITIVE,
    "surrogate.optimizer.lr": POSITIVE,
    "model.optimizer.weight_decay": NOT_NEGATIVE,
    "surrogate.optimizer.weight_decay": NOT_NEGATIVE,
    "model.network.hidden": WIDTHS,
    "surrogate.network.hidden": WIDTHS,
    "*.coefficient_share": NOT_NEGATIVE,
    "model.sampled_vertices": AT_LEAST_0,
    "*.network.context": WIDTHS,
    "*.network.corrections": AT_LEAST_0,
    **dict.fromkeys(
        (f"*.network.{key}" for key in ("stages", "width", "gate", "drivers", "parents", "corrective_width")), AT_LEAST_1
    ),
    "sampler*.max_active": AT_LEAST_1,
    "sampler*.weak_fraction": NOT_NEGATIVE,
    "sampler.fractions.*": NOT_NEGATIVE,
    "checkpoint.*": AT_LEAST_1,
    "pictures.*": AT_LEAST_1,
    "random_poses": AT_LEAST_0,
    "expressions": AT_LEAST_0,
    "window": AT_LEAST_1,
    "turns": AT_LEAST_1,
    "flags.*": POSITIVE,
    "solver.steps": AT_LEAST_1,
    "solver.clip_steps": AT_LEAST_1,
    "solver.mean_steps": AT_LEAST_0,
    "solver.key_starts": AT_LEAST_1,
    "solver.descent_steps": AT_LEAST_0,
    "solver.*": NOT_NEGATIVE,
    "frames.first": WHOLE,
    "frames.last": WHOLE,
    "reading.check_faces": BOOLEAN,
    "jobs": AT_LEAST_1,
    "budget.samples": AT_LEAST_1,
    "budget.meshes": AT_LEAST_1,
    "budget.frames": ("a whole number of at least 3", lambda value: _is_whole(value) and value >= 3),
    "budget.networks.*.steps": AT_LEAST_1,
    "budget.optimum.descent_steps": AT_LEAST_0,
    "budget.optimum.*": AT_LEAST_1,
    "columns": AT_LEAST_1,
}
MAY_BE_NULL = (
    *("frames.first", "frames.last"),
    *("stop_below_lr", "trainer.max_steps", "data.stored_poses", "sampler*.max_active", "pictures.every_n_validations"),
    *("data.store", "chunk", "expressions"),
    *("jobs", "budget.frames", "budget.networks.*.steps"),
)


def validate(config: dict[str, Any]) -> None:
    """Check the numbers of a resolved, plain config.

    Raises:
        InputError: a value is not what its key must be; the message names both.
    """
    for key, value in _leaves(config):
        check = next((check for pattern, check in RULES.items() if fnmatch(key, pattern)), None)
        if check is None or (value is None and any(fnmatch(key, pattern) for pattern in MAY_BE_NULL)):
            continue
        expected, holds = check
        if not holds(value):
            raise InputError(f"{key} is {value!r}, expected {expected}")


def _leaves(value: Any, prefix: str = "") -> list[tuple[str, Any]]:
    if not isinstance(value, dict):
        return [(prefix, value)]
    return [leaf for key, inner in value.items() for leaf in _leaves(inner, f"{prefix}.{key}" if prefix else str(key))]


def _is_whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
