"""Drafts: rigs in the terms of the DNA format, and conversion to files.

Drafts are in millimetres along riginv's axes, x to the character's left, y up, z to the front; files are in centimetres.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy import sparse

from rigs.dna.format import DnaFile, Layer
from rigs.dna.format.later_layers import Conventions
from rigs.dna.format.layers import (
    AnimatedMaps,
    Axes,
    Behavior,
    Channels,
    Conditions,
    Controls,
    Definition,
    Descriptor,
    Geometry,
    JointGroup,
    Joints,
    Lods,
    Mesh,
    Pair,
    Psds,
    RotationSigns,
    Target,
    TextureCoordinates,
    Vectors,
)
from rigs.dna.format.ragged import Ragged
from rigs.dna.logic.rotations import SEQUENCES

MM = 10.0  # to a centimetre
RIGHT, UP, FRONT, OTHER = 1, 2, 4, 5
PLAIN, WITH_CONVENTIONS = 2, 8  # versions 2.2 and 2.8
NEGLIGIBLE_MM = 1e-6  # smaller deltas are left out of targets


class Row(NamedTuple):
    """A row of the GUI table: names of the controls, and the line between two values of the GUI control."""

    gui: str
    raw: str
    lower: float
    upper: float
    slope: float
    cut: float

    @classmethod
    def between(cls, gui: str, raw: str, start: tuple[float, float], end: tuple[float, float]) -> "Row":
        """The line through two points (GUI value, raw value)."""
        slope = (end[1] - start[1]) / (end[0] - start[0])
        return cls(gui, raw, start[0], end[0], slope, start[1] - slope * start[0])


class Joint(NamedTuple):
    """A joint at rest.

    Attributes:
        parent: index, -1 for a root.
        translation: relative to its parent, mm.
        rotation: relative to its parent, degrees about x, y, z in the sequence of the draft.
    """

    name: str
    parent: int
    translation: Sequence[float] | np.ndarray
    rotation: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0)


class Group(NamedTuple):
    """A group of joints: controls, attributes (9 times the joint plus 0 to 8) and values `(attribute, control)`.

    Translations are in mm, angles in degrees.
    """

    controls: Sequence[int] | np.ndarray
    attributes: Sequence[int] | np.ndarray
    values: np.ndarray


class MeshDraft(NamedTuple):
    """A mesh.

    Attributes:
        vertices: `(vertex, 3)`, mm.
        faces: polygons of vertices.
        weights: skin weights `(vertex, joint)`; None: unskinned.
        deltas: `(vertex, 3)`, mm, by index of the channel.
    """

    name: str
    vertices: np.ndarray
    faces: Ragged
    weights: sparse.csr_array | None
    deltas: dict[int, np.ndarray]


@dataclass
class Draft:
    """Content of a DNA file; the indices of PSDs follow those of raw controls.

    Attributes:
        psds: indices of the controls that each multiplies.
        channels: name, and index of the control, of each.
        sequence: of rotations, such as `xyz`.
    """

    name: str
    gui: list[str] = field(default_factory=list)
    raw: list[str] = field(default_factory=list)
    rows: list[Row] = field(default_factory=list)
    psds: list[Sequence[int]] = field(default_factory=list)
    channels: list[tuple[str, int]] = field(default_factory=list)
    joints: list[Joint] = field(default_factory=list)
    groups: list[Group] = field(default_factory=list)
    meshes: list[MeshDraft] = field(default_factory=list)
    sequence: str = "xyz"
    notes: dict[str, str] = field(default_factory=dict)

    def file(self) -> DnaFile:
        """The file, of version 2.2, or 2.8 where rotations have another sequence than xyz."""
        contents = [self._descriptor(), self._definition(), self._behavior(), self._geometry()]
        if self.sequence != "xyz":
            contents.append(Conventions(SEQUENCES.index(self.sequence), RotationSigns(1, 1, 1), 0))
        version = PLAIN if self.sequence == "xyz" else WITH_CONVENTIONS
        return DnaFile(self.name, version, tuple(Layer.of(content) for content in contents))

    def _descriptor(self) -> Descriptor:
        notes = tuple(Pair(key, value) for key, value in self.notes.items())
        return Descriptor(self.name, OTHER, 2, 0, notes, 0, 0, Axes(RIGHT, UP, FRONT), 1, 0, "", "")

    def _definition(self) -> Definition:
        moved = [(number, channel) for number, mesh in enumerate(self.meshes) for channel in mesh.deltas]
        parents = [number if joint.parent < 0 else joint.parent for number, joint in enumerate(self.joints)]
        return Definition(
            lod_joints=_one_level(len(self.joints)),
            lod_channels=_one_level(len(self.channels)),
            lod_maps=_one_level(0),
            lod_meshes=_one_level(len(self.meshes)),
            gui_controls=tuple(self.gui),
            raw_controls=tuple(self.raw),
            joints=tuple(joint.name for joint in self.joints),
            channels=tuple(name for name, _ in self.channels),
            maps=(),
            meshes=tuple(mesh.name for mesh in self.meshes),
            channel_meshes=_shorts([mesh for mesh, _ in moved]),
            mesh_channels=_shorts([channel for _, channel in moved]),
            parents=_shorts(parents),
            neutral_translations=vectors(np.array([joint.translation for joint in self.joints]) / MM),
            neutral_rotations=vectors(np.array([joint.rotation for joint in self.joints])),
        )

    def _behavior(self) -> Behavior:
        gui, raw = ({name: number for number, name in enumerate(names)} for names in (self.gui, self.raw))
        table = Conditions(
            inputs=_shorts([gui[row.gui] for row in self.rows]),
            outputs=_shorts([raw[row.raw] for row in self.rows]),
            lower=_floats([row.lower for row in self.rows]),
            upper=_floats([row.upper for row in self.rows]),
            slopes=_floats([row.slope for row in self.rows]),
            cuts=_floats([row.cut for row in self.rows]),
        )
        members = [(len(self.raw) + row, column) for row, columns in enumerate(self.psds) for column in columns]
        psds = Psds(
            _shorts([row for row, _ in members]), _shorts([column for _, column in members]), _floats(np.ones(len(members)))
        )
        channels = [control for _, control in self.channels]
        return Behavior(
            controls=Controls(len(self.psds), table, psds),
            joints=Joints(9 * len(self.joints), len(self.raw) + len(self.psds), tuple(map(_group, self.groups))),
            channels=Channels(_shorts([len(channels)]), _shorts(channels), _shorts(np.arange(len(channels)))),
            maps=AnimatedMaps(_shorts([0]), Conditions(*[_shorts([])] * 2, *[_floats([])] * 4)),
        )

    def _geometry(self) -> Geometry:
        return Geometry(tuple(_mesh(mesh) for mesh in self.meshes))


def _group(group: Group) -> JointGroup:
    attributes = np.asarray(group.attributes)
    values = np.where((attributes % 9 < 3)[:, None], np.asarray(group.values) / MM, group.values)
    rows = _shorts([len(attributes)])
    return JointGroup(
        rows, _shorts(group.controls), _shorts(attributes), _floats(values.reshape(-1)), _shorts(np.unique(attributes // 9))
    )


def _mesh(mesh: MeshDraft) -> Mesh:
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), mesh.faces
    layout, zeros = np.arange(len(vertices), dtype=np.uint32), np.zeros(len(vertices), np.uint32)
    if mesh.weights is None:
        influences, most = (Ragged(_floats([]), np.zeros(0, np.int64)), Ragged(_shorts([]), np.zeros(0, np.int64))), 0
    else:
        weights = sparse.csr_array(mesh.weights)
        weights.eliminate_zeros()
        sizes = np.diff(weights.indptr).astype(np.int64)
        influences, most = (
            (Ragged(_floats(weights.data), sizes), Ragged(_shorts(weights.indices), sizes)),
            int(sizes.max(initial=0)),
        )
    targets = []
    for channel, deltas in mesh.deltas.items():
        moved = np.flatnonzero(np.abs(deltas).max(axis=1) > NEGLIGIBLE_MM)
        targets.append(Target(vectors(np.asarray(deltas)[moved] / MM), moved.astype(np.uint32), channel))
    return Mesh(
        positions=vectors(vertices / MM),
        texture_coordinates=TextureCoordinates(_floats([0]), _floats([0])),
        normals=vectors(_normals(vertices, faces)),
        position_of_corner=layout,
        texture_of_corner=zeros,
        normal_of_corner=layout,
        faces=Ragged(faces.values.astype(np.uint32), faces.sizes),
        most_influences=most,
        influences=influences,
        targets=tuple(targets),
    )


def _normals(vertices: np.ndarray, faces: Ragged) -> np.ndarray:
    """Area-weighted vertex normals `(vertex, 3)`."""
    starts = np.repeat(np.cumsum(faces.sizes) - faces.sizes, faces.sizes)
    corner = np.arange(len(faces.values)) - starts
    after = starts + (corner + 1) % faces.sizes[faces.owners]
    here, there = vertices[faces.values], vertices[faces.values[after]]
    areas = np.stack([np.bincount(faces.owners, part, len(faces.sizes)) for part in np.cross(here, there).T], axis=1)
    normals = np.stack([np.bincount(faces.values, part, len(vertices)) for part in areas[faces.owners].T], axis=1)
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def vectors(values: np.ndarray) -> Vectors:
    """Vectors `(vector, 3)` as a file holds them."""
    return Vectors(*np.asarray(values, dtype=np.float32).reshape(-1, 3).T.copy())


def _one_level(count: int) -> Lods:
    return Lods(_shorts([0]), (_shorts(np.arange(count)),))


def _shorts(values: Sequence[int] | np.ndarray) -> np.ndarray:
    return np.asarray(values, dtype=np.int64).reshape(-1).astype(np.uint16)


def _floats(values: Sequence[float] | np.ndarray) -> np.ndarray:
    return np.asarray(values, dtype=np.float32).reshape(-1)
