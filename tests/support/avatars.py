"""Avatars written with pygltflib, which reads and writes glTF apart from ours, for tests to read back."""

import warnings
from pathlib import Path

import numpy as np
import pygltflib as gltf
import trimesh

from rigs.face import FaceRig

TYPES = {(1,): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}


def cube() -> tuple[np.ndarray, np.ndarray]:
    """The corners `(8, 3)` of a cube of two units around the origin, and its triangles `(12, 3)`, outward."""
    box = trimesh.creation.box((2.0, 2.0, 2.0))
    return np.array(box.vertices), np.array(box.faces)


class AvatarWriter:
    """Puts arrays, meshes and nodes into a document, and writes it as .glb or .gltf."""

    def __init__(self) -> None:
        self.document = gltf.GLTF2(asset=gltf.Asset(), scene=0, scenes=[gltf.Scene(nodes=[])])
        self.blob = b""

    def view(self, data: bytes, stride: int | None = None) -> int:
        self.blob += b"\0" * (-len(self.blob) % 4)
        view = gltf.BufferView(buffer=0, byteOffset=len(self.blob), byteLength=len(data), byteStride=stride)
        self.document.bufferViews.append(view)
        self.blob += data
        return len(self.document.bufferViews) - 1

    def accessor(
        self, values: np.ndarray, dtype: str = "f4", normalized: bool = False, view: int | None = None, offset=0
    ) -> int:
        values = np.asarray(values)
        values = values[:, None] if values.ndim == 1 else values
        if view is None:
            view = self.view(values.astype(f"<{dtype}").tobytes())
        accessor = gltf.Accessor(
            bufferView=view,
            byteOffset=offset,
            componentType=COMPONENTS[dtype],
            normalized=normalized,
            count=len(values),
            type=TYPES[values.shape[1:]],
        )
        self.document.accessors.append(accessor)
        return len(self.document.accessors) - 1

    def sparse(self, values: np.ndarray, base: int | None = None) -> int:
        """An accessor that only holds the rows that are not 0, over those of a view or over zeros."""
        rows = np.flatnonzero(np.abs(values).max(axis=1))
        sparse = gltf.Sparse(
            count=len(rows),
            indices=gltf.AccessorSparseIndices(bufferView=self.view(rows.astype("<u2").tobytes()), componentType=5123),
            values=gltf.AccessorSparseValues(bufferView=self.view(values[rows].astype("<f4").tobytes())),
        )
        accessor = gltf.Accessor(bufferView=base, componentType=5126, count=len(values), type="VEC3", sparse=sparse)
        self.document.accessors.append(accessor)
        return len(self.document.accessors) - 1

    def primitive(self, positions: int, faces: np.ndarray | None, targets: list[int | None] = (), mode: int = 4, **more: int):
        indices = None if faces is None else self.accessor(np.asarray(faces).reshape(-1), "u2")
        moved = [{} if target is None else {"POSITION": target} for target in targets]
        attributes = gltf.Attributes(POSITION=positions, **more)
        return gltf.Primitive(attributes=attributes, indices=indices, targets=moved, mode=mode)

    def mesh(self, name: str, primitives: list, names: list[str] | None = None, weights: list[float] = ()) -> int:
        extras = {} if names is None else {"targetNames": names}
        self.document.meshes.append(gltf.Mesh(name=name, primitives=primitives, extras=extras, weights=list(weights)))
        return len(self.document.meshes) - 1

    def node(self, name: str, parent: int | None = None, **fields) -> int:
        self.document.nodes.append(gltf.Node(name=name, **fields))
        number = len(self.document.nodes) - 1
        if parent is None:
            self.document.scenes[0].nodes.append(number)
        else:
            self.document.nodes[parent].children.append(number)
        return number

    def skin(self, joints: list[int], inverse_binds: np.ndarray | None = None) -> int:
        """A skin; `inverse_binds` `(joint, 4, 4)` as matrices are written on paper, not by columns as in the file."""
        accessor = None if inverse_binds is None else self.accessor(np.asarray(inverse_binds).transpose(0, 2, 1))
        self.document.skins.append(gltf.Skin(joints=joints, inverseBindMatrices=accessor, name="skin"))
        return len(self.document.skins) - 1

    def animation(self, name: str | None, *channels: tuple) -> int:
        """An animation of channels `(node, path, times, values)`, and how it goes on between keys where not linearly."""
        found = gltf.Animation(name=name)
        inputs: dict[bytes, int] = {}
        for node, path, times, values, *how in channels:
            times = np.asarray(times, np.float32)
            if times.tobytes() not in inputs:
                inputs[times.tobytes()] = self.accessor(times)
            values = np.asarray(values, np.float64)
            output = self.accessor(values.reshape(-1) if path == "weights" else values.reshape(-1, values.shape[-1]))
            sampler = gltf.AnimationSampler(input=inputs[times.tobytes()], output=output, interpolation=(how or ["LINEAR"])[0])
            found.samplers.append(sampler)
            target = gltf.AnimationChannelTarget(node=node, path=path)
            found.channels.append(gltf.AnimationChannel(sampler=len(found.samplers) - 1, target=target))
        self.document.animations.append(found)
        return len(self.document.animations) - 1

    def write(self, path: Path) -> Path:
        self.document.buffers = [gltf.Buffer(byteLength=len(self.blob))]
        self.document.set_binary_blob(self.blob)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "This file .* contains a binary blob")  # saved as a .bin beside a .gltf
            self.document.save(str(path), asset=self.document.asset)
        return path


def add_cube(
    avatar: AvatarWriter, name: str, names: list[str] | None, seed: int, parent: int | None = None, skin: int | None = None
) -> tuple[int, np.ndarray, np.ndarray]:
    """A node with a crooked cube of about 0.2 m, a morph target for each name; bound to the first two joints of a skin.

    Returns:
        the node, the positions `(8, 3)` and the deltas `(target, 8, 3)`, metres.
    """
    rng, (corners, faces) = np.random.default_rng(seed), cube()
    points = 0.1 * corners + 0.01 * rng.normal(size=corners.shape) + [0.05 * seed, 0, 0]
    deltas = 0.02 * rng.normal(size=(len(names or []), *points.shape))
    more = {}
    if skin is not None:
        shares = np.zeros((8, 4))
        shares[:, 0] = rng.uniform(0.1, 0.9, 8)
        shares[:, 1] = 1 - shares[:, 0]
        joints = np.tile([0, 1, 0, 0], (8, 1))
        more = {"JOINTS_0": avatar.accessor(joints, "u1"), "WEIGHTS_0": avatar.accessor(shares)}
    primitive = avatar.primitive(avatar.accessor(points), faces, [avatar.accessor(delta) for delta in deltas], **more)
    return avatar.node(name, parent, mesh=avatar.mesh(name, [primitive], names), skin=skin), points, deltas


def face_avatar(path: Path, face: FaceRig, targets: int, joints: bool = False) -> Path:
    """The face rig's first primary shapes as the morph targets of an avatar, in metres, some of them sparse.

    Args:
        joints: whether a skin of neck, head and jaw carries it.
    """
    avatar = AvatarWriter()
    deltas = face.basis[:targets].double().numpy() / 1000
    accessors = [avatar.sparse(delta) if number % 3 == 0 else avatar.accessor(delta) for number, delta in enumerate(deltas)]
    rest = face.rest_vertices.double().numpy() / 1000
    skin, more = (None, {}) if not joints else _bind(avatar, rest)
    primitive = avatar.primitive(avatar.accessor(rest), face.faces.numpy(), accessors, **more)
    avatar.node("Head", mesh=avatar.mesh("Head", [primitive], list(face.coefficient_names[:targets])), skin=skin)
    return avatar.write(path)


def _bind(avatar: AvatarWriter, rest: np.ndarray) -> tuple[int, dict[str, int]]:
    """A skin of neck, head and jaw for the face `(vertex, 3)`, m, and the attributes that bind vertices to it."""
    low, high = rest.min(axis=0), rest.max(axis=0)
    up, front = ((rest - low) / (high - low)).T[1:]
    places = [low + (high - low) * share for share in ([0.5, -0.1, 0.0], [0.5, 0.3, 0.1], [0.5, 0.35, 0.4])]
    joints: list[int] = []
    for name, parent, place in zip(("neck", "head", "jaw"), (None, 0, 1), places):
        before = 0 if parent is None else places[parent]
        above = None if parent is None else joints[parent]
        joints.append(avatar.node(name, above, translation=(place - before).tolist()))
    jaw = np.clip(1 - up / 0.35, 0, 1) * np.clip(2 * front - 0.5, 0, 1)
    neck = (1 - jaw) * np.clip(0.5 - 2.5 * up, 0, 1)
    shares = np.stack([neck, 1 - jaw - neck, jaw, 0 * jaw], axis=1)
    binds = np.tile(np.eye(4), (3, 1, 1))
    binds[:, :3, 3] = -np.array(places)
    numbers = avatar.accessor(np.tile([0, 1, 2, 0], (len(rest), 1)), "u1")
    return avatar.skin(joints, binds), {"JOINTS_0": numbers, "WEIGHTS_0": avatar.accessor(shares)}
