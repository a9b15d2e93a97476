"""The config of `riginv.reproduce`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from riginv.clips.options import FrameOptions, ReadingOptions
from riginv.config.building import ClassSpec
from riginv.config.typed import REST
from riginv.config.values import Bound, PositiveInt
from riginv.rig.interface import RigBackend

TEST_FRACTION = 10  # one of so many samples is a test sample


def _are_seeds(values: Sequence[int]) -> bool:
    return bool(values) and min(values) >= 0 and len(set(values)) == len(values)


Seeds = Annotated[Sequence[int], Bound("different whole numbers of at least 0, such as [0,1,2]", _are_seeds)]


@dataclass(frozen=True)
class NetworkBudget:
    """The training of a network.

    Attributes:
        steps: training steps; None: as in `settings`.
        settings: arguments of `riginv.train`.
    """

    steps: PositiveInt | None
    settings: Sequence[str]


@dataclass(frozen=True)
class Networks:
    """The networks of the paper, ours (`best`), and that of the body's figure."""

    surrogate: NetworkBudget
    inverse: NetworkBudget
    holden: NetworkBudget
    best: NetworkBudget
    body: NetworkBudget


@dataclass(frozen=True)
class Variant:
    """A network with further settings, for one seed.

    Attributes:
        of: `trained` is the inverse through a trained rig.
    """

    of: Literal["surrogate", "inverse", "trained"]
    settings: Sequence[str]


@dataclass(frozen=True)
class Budget:
    """The amount of computation; conf/budget/quick.yaml explains each key."""

    name: str
    about: str
    seeds: Seeds
    samples: PositiveInt
    meshes: PositiveInt
    frames: PositiveInt | None
    settings: Sequence[str]
    networks: Networks
    variants: Mapping[str, Variant] | None
    others: Sequence[str]
    optimum: Mapping[str, Any]

    @property
    def test_samples(self) -> int:
        """Number of samples for evaluation."""
        return max(1, self.samples // TEST_FRACTION)

    @property
    def training_samples(self) -> int:
        """Number of samples that a surrogate is trained on."""
        return max(1, self.samples - self.test_samples)


@dataclass(frozen=True)
class TrueRigConfig:
    """The rig for evaluation.

    Attributes:
        rig: None: the programmatic rig itself.
        only_if_here: whether the programmatic rig replaces it where it cannot be built.
    """

    rig: ClassSpec[RigBackend] | None = field(metadata=REST)
    only_if_here: bool = False


@dataclass(frozen=True)
class ReproduceConfig:
    """The config of `riginv.reproduce`; conf/reproduce.yaml explains each key."""

    rig: ClassSpec[RigBackend]
    true_rig: TrueRigConfig
    body: ClassSpec[RigBackend] | None
    budget: Budget
    reading: ReadingOptions
    frames: FrameOptions
    capture: str | None
    jobs: PositiveInt | None = None
    resume: bool = True
