"""Former names in configs: of classes, of their arguments, and of choices of groups.

Saved configs (bundles, stores, runs) with former names are upgraded as they are read. In the configs of users former names of
classes are understood, former names of arguments and choices are errors that state the present ones.
"""

from collections.abc import Mapping
from typing import Any

MODULES = {  # former modules of classes that configs may name
    "riginv.fitted_rig": "riginv.rig.black_box",
    "riginv.recorded_rig": "riginv.rig.recorded",
    "riginv.losses": "riginv.training.losses",
    "riginv.modules.forward": "riginv.training.forward",
    "riginv.modules.holden": "riginv.training.holden",
    "riginv.modules.inverse": "riginv.training.inverse",
    "riginv.sampling.loose": "riginv.sampling.joint_noise",
    "riginv.methods.neutral": "riginv.methods.direct",
    **{
        f"riginv.baselines.{name}": f"riginv.methods.baselines.{name}"
        for name in (
            *("blendshape_weights", "clustered_gaussian_processes", "coordinate_descent", "gaussian_process"),
            *("holden_gaussian_process", "holden_network", "majorisation", "quadratic", "tabulated"),
        )
    },
}
KEYS = {"judging": "evaluation", "turns": "iterations"}  # former keys at the top of the configs of commands
CLASSES = {  # former names of classes, in their present modules
    "riginv.rig.black_box.FittedRig": "BlackBoxRig",
    "riginv.training.losses.VertexDistanceLoss": "RmsVertexDistanceLoss",
    "riginv.sampling.joint_noise.LoosePoses": "JointNoisePoses",
}
ARGUMENTS = {  # former names of arguments, by the class
    "riginv.sampling.controls.SparseControls": {"most": "max_active"},
    "riginv.sampling.controls.PlausibleControls": {"most": "max_active", "faint": "weak_fraction"},
    "riginv.sampling.meshes.PlausibleCombinations": {"most": "max_active", "faint": "weak_fraction"},
    "riginv.sampling.correlated.CorrelatedControls": {"reach": "correlation_length", "sparse": "sparse_fraction"},
    "riginv.sampling.meshes.Mixture": {"shares": "fractions"},
    "riginv.networks.inverse.StagedInverse": {"corrections": "refinement_steps"},
    "riginv.training.forward.ForwardModule": {"coefficient_share": "coefficient_weight"},
}
CHOICES = {"sampler": {"loose_poses": "joint_noise_poses"}}  # former choices of groups, by the group
PARTS = ("samplers", "fractions")  # arguments of a mixture whose names are those of choices of `sampler`


def present_class(target: str) -> str:
    """The present name of a class that a config names."""
    module, _, name = target.rpartition(".")
    module = MODULES.get(module, module)
    return f"{module}.{CLASSES.get(f'{module}.{name}', name)}"


def present_argument(target: str, name: str) -> str | None:
    """The present name of a class's argument; None where it is not a former name."""
    return ARGUMENTS.get(present_class(target), {}).get(name)


def present_key(key: str) -> str | None:
    """The present name of a dotted key that a user typed; None where it holds no former name."""
    group, *rest = key.split(".")
    renamed = dict(CHOICES.get(group.partition("@")[0], {}))
    for target, names in ARGUMENTS.items():
        if group.partition("@")[0] == ("sampler" if target.startswith("riginv.sampling.") else "model"):
            renamed |= names
    present = ".".join([KEYS.get(group, group), *(renamed.get(word, word) for word in rest)])
    return present if present != key else None


def upgraded(config: Mapping[str, Any]) -> dict[str, Any]:
    """A saved config with the present names of keys, classes, their arguments, and the parts of mixtures."""
    return {KEYS.get(key, key): value for key, value in _upgraded(config).items()}


def _upgraded(config: Any) -> Any:
    if isinstance(config, list):
        return [_upgraded(value) for value in config]
    if not isinstance(config, Mapping):
        return config
    target = config.get("_target_")
    names = ARGUMENTS.get(present_class(target), {}) if isinstance(target, str) else {}
    result = {names.get(key, key): _upgraded(value) for key, value in config.items()}
    if isinstance(target, str):
        result["_target_"] = present_class(target)
    for part in PARTS if "shares" in names else ():
        if isinstance(result.get(part), Mapping):
            result[part] = {CHOICES["sampler"].get(name, name): value for name, value in result[part].items()}
    return result
