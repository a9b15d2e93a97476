"""Avatars in glTF as rigs: morph targets, and on request joints, as controls."""

from collections.abc import Sequence

import torch
from torch import Tensor

from riginv.rig import Control, LinearRig
from rigs.gltf.arkit import arkit_targets
from rigs.gltf.avatar import read_avatar

SHOWN = 12  # targets that pictures show alone


class GltfRig(LinearRig):
    """An avatar from a .glb, .gltf or .vrm file.

    Args:
        file: the file.
        include: globs of the meshes, or their nodes, that make the rig; empty: all that can move.
        exclude: globs of those that do not.
        unit_mm: millimetres to a unit of the file: 1000, as glTF is in metres.
        weld: make one of the vertices that seams split.
        default_weights: whether the neutral controls are the weights that the file rests at; else 0.

    Attributes:
        targets: the names of the morph targets.
        vertex_map: the rig's vertex of each of the file's, `(file vertex,)`: `vertices[:, vertex_map]` has the file's order.
        parts: for each run of file vertices the mesh and primitive they belong to, their first and one past their last.

    Raises:
        InputError: the file cannot be read or holds no rig; the message names the file, and what in it.
    """

    vertex_map: Tensor

    def __init__(
        self,
        file: str,
        include: Sequence[str] = (),
        exclude: Sequence[str] = (),
        unit_mm: float = 1000.0,
        weld: bool = False,
        default_weights: bool = False,
    ) -> None:
        avatar = read_avatar(file, list(include), list(exclude), unit_mm, weld, joints=False)
        basis = torch.tensor(avatar.deltas)
        rests = [avatar.defaults[name] if default_weights else 0.0 for name in avatar.targets]
        controls = [Control(name, min(0.0, rest), max(1.0, rest), rest) for name, rest in zip(avatar.targets, rests)]
        rest = torch.tensor(avatar.rest + 0.0, dtype=torch.float32) + torch.einsum("k,kvc->vc", torch.tensor(rests), basis)
        count = 0 if any(rests) else len(controls)  # blendshape weights are 0 at rest
        super().__init__(avatar.file.path.stem, controls, rest, torch.tensor(avatar.faces), basis, avatar.targets, count)
        self.targets = tuple(avatar.targets)
        self.parts = tuple((piece.label, piece.start, piece.start + piece.count) for piece in avatar.pieces)
        self.register_buffer("vertex_map", torch.tensor(avatar.vertex_map), persistent=False)

    def coefficients(self, controls: Tensor) -> Tensor:
        """Controls `(batch, control)` to the weights `(batch, target)` of the morph targets, which they are."""
        return controls

    def arkit_deltas(self) -> dict[str, Tensor]:
        place = {name: number for number, name in enumerate(self.targets)}
        return {arkit: self.basis[place[name]] for arkit, name in arkit_targets(list(self.targets)).items()}

    def expressions(self) -> dict[str, dict[str, float]]:
        step = max(1, len(self.targets) // SHOWN)
        return {name: {name: 1.0} for name in self.targets[::step][:SHOWN]}
