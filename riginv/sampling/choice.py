"""Which parts of a mixture a rig gets: one default serves rigs with blendshapes and rigs without."""

from typing import Any

from riginv.build import class_of
from riginv.rig import LinearRig
from riginv.sampling.controls import ControlSampler
from riginv.sampling.meshes import MeshSampler

Config = dict[str, Any]


def fitted(config: Config, rig: LinearRig) -> Config:
    """The config of a sampler, less those parts of a mixture whose classes do not belong to the rig.

    Random combinations need blendshapes; poses whose joints move together are for rigs without. A sampler that is not a
    mixture stays as it is: what does not suit the rig then says so.

    Raises:
        InputError: a part names a class that does not exist.
    """
    if "samplers" not in config:
        return config
    parts = {name: part for name, part in config["samplers"].items() if _belongs(part, rig, MeshSampler)}
    shares = {name: share for name, share in config["shares"].items() if name in parts or name not in config["samplers"]}
    return {**config, "samplers": parts, "shares": shares}


def _belongs(part: Config, rig: LinearRig, kind: type[MeshSampler | ControlSampler]) -> bool:
    inner = part.get("controls")
    belongs = class_of(part.get("_target_"), kind=kind).belongs_to(rig)
    return belongs and (inner is None or _belongs(inner, rig, ControlSampler))
