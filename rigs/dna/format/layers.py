"""The layers that every DNA file has: descriptor, definition, behavior, geometry."""

from dataclasses import dataclass

from rigs.dna.format.codecs import Corners, Floats, Influences, Long, Longs, Short, Shorts, Sized, String


@dataclass(frozen=True)
class Pair:
    """An entry of the metadata."""

    key: String
    value: String


@dataclass(frozen=True)
class Axes:
    """The directions of the axes: 0 left, 1 right, 2 up, 3 down, 4 front, 5 back."""

    x: Short
    y: Short
    z: Short


@dataclass(frozen=True)
class Vectors:
    """Vectors, coordinate by coordinate."""

    xs: Floats
    ys: Floats
    zs: Floats


@dataclass(frozen=True)
class Lods:
    """Indices for each level of detail.

    Attributes:
        row_of_lod: which of `rows` each level uses.
        rows: lists of indices; levels may share one.
    """

    row_of_lod: Shorts
    rows: tuple[Shorts, ...]


@dataclass(frozen=True)
class Descriptor:
    """Layer `desc`: what the character is, units and axes.

    Attributes:
        translation_unit: 0 cm, 1 m.
        rotation_unit: 0 degrees, 1 radians.
        lod_count: how many levels of detail there are.
        first_lod: which level of the database is level 0 here.
    """

    name: String
    archetype: Short
    gender: Short
    age: Short
    metadata: tuple[Pair, ...]
    translation_unit: Short
    rotation_unit: Short
    axes: Axes
    lod_count: Short
    first_lod: Short
    complexity: String
    database: String


@dataclass(frozen=True)
class Definition:
    """Layer `defn`: names, hierarchy, neutral pose.

    Attributes:
        channel_meshes, mesh_channels: pairs of a mesh and a channel that moves it.
        parents: of each joint; a root is its own.
        neutral_translations, neutral_rotations: of each joint against its parent.
    """

    lod_joints: Lods
    lod_channels: Lods
    lod_maps: Lods
    lod_meshes: Lods
    gui_controls: tuple[String, ...]
    raw_controls: tuple[String, ...]
    joints: tuple[String, ...]
    channels: tuple[String, ...]
    maps: tuple[String, ...]
    meshes: tuple[String, ...]
    channel_meshes: Shorts
    mesh_channels: Shorts
    parents: Shorts
    neutral_translations: Vectors
    neutral_rotations: Vectors


@dataclass(frozen=True)
class Conditions:
    """Rows of a piecewise linear table: where `lower <= input <= upper`, `slope * input + cut` is added to the output."""

    inputs: Shorts
    outputs: Shorts
    lower: Floats
    upper: Floats
    slopes: Floats
    cuts: Floats


@dataclass(frozen=True)
class Psds:
    """A sparse matrix: the controls that a pose-space driver multiplies, and factors."""

    rows: Shorts
    columns: Shorts
    values: Floats


@dataclass(frozen=True)
class Controls:
    """The dependencies between controls."""

    psd_count: Short
    table: Conditions
    psds: Psds


@dataclass(frozen=True)
class JointGroup:
    """A matrix from some controls to some attributes of joints.

    Attributes:
        row_counts: how many of the rows each level of detail uses.
        inputs: a control for each column.
        outputs: an attribute for each row: 9 times the joint, plus 0 to 8 for translation, rotation and scale by x, y, z.
        values: row by row.
        joints: those that the rows belong to.
    """

    row_counts: Shorts
    inputs: Shorts
    outputs: Shorts
    values: Floats
    joints: Shorts


@dataclass(frozen=True)
class Joints:
    """The dependencies of joints on controls."""

    attribute_count: Short
    control_count: Short
    groups: tuple[JointGroup, ...]


@dataclass(frozen=True)
class Channels:
    """The controls that are the weights of blendshape channels; each level of detail uses the first few."""

    counts: Shorts
    inputs: Shorts
    outputs: Shorts


@dataclass(frozen=True)
class AnimatedMaps:
    """A table from controls to animated maps; each level of detail uses the first few rows."""

    counts: Shorts
    table: Conditions


@dataclass(frozen=True)
class Behavior:
    """Layer `bhvr`: from controls to joints, channels and maps."""

    controls: Controls
    joints: Joints
    channels: Channels
    maps: AnimatedMaps


@dataclass(frozen=True)
class TextureCoordinates:
    """Texture coordinates."""

    us: Floats
    vs: Floats


@dataclass(frozen=True)
class Target:
    """The vertices that a blendshape channel moves in a mesh, and how far."""

    deltas: Vectors
    vertices: Longs
    channel: Short


@dataclass(frozen=True)
class Mesh:
    """One mesh.

    Attributes:
        position_of_corner, texture_of_corner, normal_of_corner: the layouts that faces refer to.
        faces: the layouts at the corners of each.
        most_influences: the greatest number of joints of a vertex.
        influences: for each vertex the skin weights, and their joints.
    """

    positions: Vectors
    texture_coordinates: TextureCoordinates
    normals: Vectors
    position_of_corner: Longs
    texture_of_corner: Longs
    normal_of_corner: Longs
    faces: Corners
    most_influences: Short
    influences: Influences
    targets: tuple[Target, ...]


@dataclass(frozen=True)
class Geometry:
    """Layer `geom`: the meshes."""

    meshes: tuple[Sized[Mesh], ...]


@dataclass(frozen=True)
class RotationSigns:
    """1, or 0xFFFFFFFF for -1: how rotation angles about each axis count."""

    x: Long
    y: Long
    z: Long
