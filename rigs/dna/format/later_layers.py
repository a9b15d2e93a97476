"""The layers that later versions added: machine learning, radial basis functions, quaternion joints, twists, conventions."""

from dataclasses import dataclass

from rigs.dna.format.codecs import Byte, Float, Floats, Long, Longs, Short, Shorts, Sized, String
from rigs.dna.format.layers import Lods, RotationSigns


@dataclass(frozen=True)
class NetLayer:
    """One layer of a net: activation(weights inputs + bias); weights row by row, one row for each output."""

    biases: Floats
    weights: Floats
    activation: Short
    parameters: Floats


@dataclass(frozen=True)
class Net:
    """A small network from controls to controls."""

    outputs: Shorts
    inputs: Shorts
    layers: tuple[NetLayer, ...]


@dataclass(frozen=True)
class MachineLearning:
    """Layer `mlbh`: nets.

    Attributes:
        controls: names of the controls that nets write.
        lod_nets: the nets of each level of detail.
        regions: names of the regions of each mesh.
        region_nets: the nets of each region of each mesh.
    """

    controls: tuple[String, ...]
    lod_nets: Lods
    regions: tuple[tuple[String, ...], ...]
    region_nets: tuple[tuple[Shorts, ...], ...]
    nets: tuple[Sized[Net], ...]


@dataclass(frozen=True)
class Solver:
    """Poses of some controls, and how the weight of each falls with the distance from it.

    Attributes:
        values: of the controls, pose by pose.
        kind: 0 additive, 1 interpolative.
        automatic_radius: 0 on, 1 off.
        distance: 0 Euclidean, 1 quaternion, 2 swing, 3 twist.
        normalise: 0 above a sum of one only, 1 always.
        function: 0 Gaussian, 1 exponential, 2 linear, 3 cubic, 4 quintic.
        axis: 0 x, 1 y, 2 z.
    """

    name: String
    controls: Shorts
    poses: Shorts
    values: Floats
    radius: Float
    threshold: Float
    kind: Short
    automatic_radius: Short
    distance: Short
    normalise: Short
    function: Short
    axis: Short


@dataclass(frozen=True)
class Pose:
    """A pose that solvers share, and the factor on its weight."""

    name: String
    scale: Float


@dataclass(frozen=True)
class RadialBasis:
    """Layer `rbfb`: solvers and poses."""

    lod_solvers: Lods
    solvers: tuple[Sized[Solver], ...]
    poses: tuple[Pose, ...]


@dataclass(frozen=True)
class PoseOutput:
    """The controls that multiply the weight of a pose, and the controls that it then adds to."""

    inputs: Shorts
    outputs: Shorts
    weights: Floats


@dataclass(frozen=True)
class RadialBasisOutputs:
    """Layer `rbfe`: names of RBF controls, and what each pose writes."""

    controls: tuple[String, ...]
    poses: tuple[PoseOutput, ...]


@dataclass(frozen=True)
class Representation:
    """The representation of a joint's rotation: 0 Euler angles, 1 quaternion."""

    translation: Short
    rotation: Short
    scale: Short


@dataclass(frozen=True)
class JointRepresentations:
    """Layer `jbmd`."""

    joints: tuple[Representation, ...]


@dataclass(frozen=True)
class Twist:
    """Joints that take part of the twist, or of the swing, of a quaternion held by four controls (x, y, z, w)."""

    weights: Floats
    joints: Shorts
    controls: Shorts
    axis: Short


@dataclass(frozen=True)
class TwistsAndSwings:
    """Layer `twsw`."""

    twists: tuple[Twist, ...]
    swings: tuple[Twist, ...]


@dataclass(frozen=True)
class Operation:
    """One step of a network of operations; kind 1 gather, 2 scatter, 3 net, 4 weighted sum."""

    parameters: Longs
    sets: Shorts
    operations: Shorts
    kind: Short


@dataclass(frozen=True)
class OperationSets:
    """Sets of operations, and which operations of each set every level of detail uses."""

    lods: tuple[Lods, ...]
    sets: tuple[tuple[Operation, ...], ...]


@dataclass(frozen=True)
class MachineLearningOperations:
    """Layer `mlbe`: operations that nets are part of, and joints that nets move.

    Attributes:
        keys, values: parameters of the joints: 0, 1, 2 types of translation, rotation, scale; 3 to 9 a change of basis.
        inputs: a control for each attribute.
        outputs: attributes, 9 or 10 to a joint.
    """

    types: tuple[OperationSets, ...]
    keys: Shorts
    values: Shorts
    inputs: Shorts
    outputs: Shorts


@dataclass(frozen=True)
class Conventions:
    """Layer `dsce`: sequence 0 xyz, 1 xzy, 2 yxz, 3 yzx, 4 zxy, 5 zyx; winding 0 counter-clockwise, 1 clockwise (2.8)."""

    sequence: Long
    signs: RotationSigns
    winding: Byte
