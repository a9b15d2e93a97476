"""Features of a mesh for an inverse network in place of mesh coordinates, such as joint rotations (`LinearRig.features`).

In mesh coordinates a bent finger looks different for every rotation of the body; its rotation relative to its parent does not.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from riginv.rig.batches import generator_at
from riginv.rig.interface import LinearRig
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.rig.random_controls import sparse_controls

NOISE_MM = 0.1  # standard deviation of the noise that the estimate of coefficients assumes in each mesh coordinate
POSES = 512  # random poses that give the spread of each coefficient
MIN_SCALE = 0.1  # least scale of a feature, relative to the typical one, for features that hardly vary
GUESS_POSES = 4096  # random poses that the first guess is fitted to
LEAST_VARIANCE = 1e-2  # of scaled features, for a direction to be used by the first guess


class RigFeatures(nn.Module):
    """Maps mesh coordinates to the rig's features, and these to a first guess at the controls.

    The rig's coefficients are estimated linearly from mesh coordinates, as the most likely ones given a little noise. The first
    guess is the rig's own (`LinearRig.guess_from_features`), or else a linear regression on random poses of the rig, along the
    directions in which their features vary.
    """

    scale: Tensor
    derivative: Tensor
    neutral: Tensor
    rest: Tensor
    estimate: Tensor

    def __init__(self, rig: RigInMeshSpace) -> None:
        super().__init__()
        self.rig = [rig.source]  # in a list, so that the rig is no submodule
        backend, neutral = rig.source, rig.neutral_coefficients
        draws = torch.rand(POSES, len(backend.controls), generator=generator_at(0, "features"), dtype=torch.float64)
        with torch.no_grad():
            controls = backend.lower + draws.to(backend.lower) * (backend.upper - backend.lower)
            spread = (backend.coefficients(controls) - neutral).double().square().mean(dim=0).sqrt()
            moved = spread[:, None] * rig.linear_map.double()
            gram = moved.T @ moved + NOISE_MM**2 * torch.eye(moved.shape[1], dtype=moved.dtype, device=moved.device)
            estimate = torch.linalg.solve(gram, moved.T) * spread
            rest = _features_of(backend, neutral)
        self.register_buffer("neutral", neutral, persistent=False)
        self.register_buffer("rest", rest, persistent=False)
        self.register_buffer("estimate", estimate.to(neutral), persistent=False)
        self.register_buffer("scale", torch.ones_like(rest[0]))
        self.register_buffer("derivative", torch.zeros(len(rest[0]), len(backend.controls)).to(rest))

    @staticmethod
    def offered_by(rig: RigInMeshSpace) -> bool:
        """Whether a rig has features (`LinearRig.features`), or a fitted basis, whose coefficients are these."""
        return rig.source.gradient_steps > 0 or rig.source.features(rig.neutral_coefficients) is not None

    @classmethod
    def fitted(cls, rig: RigInMeshSpace) -> "RigFeatures":
        """Features without a network, calibrated on random poses of the rig; where it has none, its coefficients are these."""
        features, backend = cls(rig), rig.source
        limits = backend.lower, backend.upper, backend.neutral_controls
        features.calibrate(rig, rig(sparse_controls(*limits, len(backend.controls), POSES, generator_at(0, "scale"))))
        return features

    @property
    def size(self) -> int:
        return len(self.scale)

    @torch.no_grad()
    def calibrate(self, rig: RigInMeshSpace, coordinates: Float[Tensor, "batch coordinate"]) -> None:
        """Set the scale of each feature from sampled mesh coordinates `(batch, coordinate)`, and fit the first guess."""
        self.scale.fill_(1.0)
        sizes = self.forward(coordinates).square().mean(dim=0).sqrt()
        typical = sizes.square().mean().sqrt()
        self.scale.copy_(sizes.clamp_min(MIN_SCALE * typical.clamp_min(1e-12)))
        backend = self.rig[0]
        if backend.guess_from_features(self.rest) is not None:
            return
        limits = backend.lower, backend.upper, backend.neutral_controls
        generator = generator_at(0, "first guess", device=coordinates.device)
        controls = sparse_controls(*limits, len(backend.controls), GUESS_POSES, generator)
        seen = torch.cat([self.forward(rig(batch)) for batch in controls.split(POSES)]).double()
        changes = ((controls - backend.neutral_controls) / (backend.upper - backend.lower)).double()
        variances, directions = torch.linalg.eigh(seen.T @ seen / len(seen))
        inverse = torch.where(variances > LEAST_VARIANCE, 1 / variances.clamp_min(LEAST_VARIANCE), 0.0)
        derivative = (directions * inverse) @ directions.T @ (seen.T @ changes) / len(seen)
        self.derivative.copy_(derivative * (backend.upper - backend.lower))

    def guess(self, features: Float[Tensor, "batch feature"]) -> Float[Tensor, "batch control"]:
        """A first guess at the controls `(batch, control)` from features `(batch, feature)`; it may exceed the limits."""
        own = self.rig[0].guess_from_features(self.rest + features * self.scale)
        return self.rig[0].neutral_controls + features @ self.derivative if own is None else own

    def forward(self, coordinates: Float[Tensor, "batch coordinate"]) -> Float[Tensor, "batch feature"]:
        """Mesh coordinates `(batch, coordinate)` to features `(batch, feature)`; 0 at the neutral mesh."""
        return self.change(self.rest, self.unscaled(coordinates))

    def change(self, before: Tensor, after: Tensor) -> Tensor:
        """The scaled difference of unscaled features, all `(batch, feature)`."""
        return self.rig[0].feature_change(before, after) / self.scale

    def unscaled(self, coordinates: Float[Tensor, "batch coordinate"]) -> Float[Tensor, "batch feature"]:
        """Mesh coordinates `(batch, coordinate)` to the rig's own features `(batch, feature)`."""
        return _features_of(self.rig[0], self.neutral + coordinates @ self.estimate)


def _features_of(rig: LinearRig, coefficients: Tensor) -> Tensor:
    """The rig's features `(batch, feature)`; where it has none, the coefficients themselves."""
    features = rig.features(coefficients)
    return coefficients if features is None else features
