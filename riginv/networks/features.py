"""A mesh in the terms of its rig: what an inverse looks at where mesh coordinates alone would hide what it needs.

A joint's angle shows in a mesh only against the joint above it: in mesh coordinates a bent finger looks different for every
turn of the body. Such a rig says what of its coefficients tells about its controls (`LinearRig.features`).
"""

import torch
from torch import Tensor, nn

from riginv.rig.batches import generator_at
from riginv.rig.mesh_space import RigInMeshSpace
from riginv.rig.random_controls import sparse_controls

NOISE_MM = 0.1  # that the estimate reckons with in each mesh coordinate: what a coefficient hardly moves is not taken from it
POSES = 512  # of the rig, from which it learns how far each coefficient goes
SMALLEST = 0.1  # of the typical size of a feature: one that the rig's poses never move must not shout when a capture does
GUESS_POSES = 4096  # of the rig, which the first guess is fitted to
LEAST_VARIANCE = 1e-2  # of scaled features: a direction in which poses of the rig hardly differ says nothing about controls


class RigFeatures(nn.Module):
    """The rig's own features of a mesh: its coefficients are estimated from mesh coordinates, then seen as the rig sees them.

    The estimate is linear: the likeliest coefficients of a pose of the rig, given the mesh and a little noise. From the
    features a first guess at the controls is linear, too: a regression on random poses of the rig, along the directions in
    which these differ; others, which only a capture may hold, do not disturb it.
    """

    scale: Tensor
    derivative: Tensor

    def __init__(self, rig: RigInMeshSpace) -> None:
        super().__init__()
        self.rig = [rig.rig]  # in a list: the rig's weights are not this module's
        backend, neutral = rig.rig, rig.neutral_coefficients
        draws = torch.rand(POSES, len(backend.controls), generator=generator_at(0, "features"), dtype=torch.float64)
        with torch.no_grad():
            controls = backend.lower + draws.to(backend.lower) * (backend.upper - backend.lower)
            spread = (backend.coefficients(controls) - neutral).double().square().mean(dim=0).sqrt()
            moved = spread[:, None] * rig.linear_map.double()
            gram = moved.T @ moved + NOISE_MM**2 * torch.eye(moved.shape[1], dtype=moved.dtype, device=moved.device)
            estimate = torch.linalg.solve(gram, moved.T) * spread
            rest = backend.features(neutral)
        self.register_buffer("neutral", neutral, persistent=False)
        self.register_buffer("rest", rest, persistent=False)
        self.register_buffer("estimate", estimate.to(neutral), persistent=False)
        self.register_buffer("scale", torch.ones_like(rest[0]))
        self.register_buffer("derivative", torch.zeros(len(rest[0]), len(backend.controls)).to(rest))

    @staticmethod
    def offered_by(rig: RigInMeshSpace) -> bool:
        """Whether the rig tells features at all (`LinearRig.features`)."""
        return rig.rig.features(rig.neutral_coefficients) is not None

    @classmethod
    def fitted(cls, rig: RigInMeshSpace) -> "RigFeatures":
        """For use without a network: calibrated on random poses of the rig."""
        features, backend = cls(rig), rig.rig
        limits = backend.lower, backend.upper, backend.neutral_controls
        features.calibrate(rig, rig(sparse_controls(*limits, len(backend.controls), POSES, generator_at(0, "scale"))))
        return features

    @property
    def size(self) -> int:
        return len(self.scale)

    @torch.no_grad()
    def calibrate(self, rig: RigInMeshSpace, coordinates: Tensor) -> None:
        """Set the scale of each feature by a sample of mesh coordinates `(batch, coordinate)`, and fit the first guess."""
        self.scale.fill_(1.0)
        sizes = self.forward(coordinates).square().mean(dim=0).sqrt()
        typical = sizes.square().mean().sqrt()
        self.scale.copy_(sizes.clamp_min(SMALLEST * typical.clamp_min(1e-12)))
        backend = self.rig[0]
        limits = backend.lower, backend.upper, backend.neutral_controls
        generator = generator_at(0, "first guess", device=coordinates.device)
        controls = sparse_controls(*limits, len(backend.controls), GUESS_POSES, generator)
        seen = torch.cat([self.forward(rig(piece)) for piece in controls.split(POSES)]).double()
        changes = ((controls - backend.neutral_controls) / (backend.upper - backend.lower)).double()
        variances, directions = torch.linalg.eigh(seen.T @ seen / len(seen))
        inverse = torch.where(variances > LEAST_VARIANCE, 1 / variances.clamp_min(LEAST_VARIANCE), 0.0)
        derivative = (directions * inverse) @ directions.T @ (seen.T @ changes) / len(seen)
        self.derivative.copy_(derivative * (backend.upper - backend.lower))

    def guess(self, features: Tensor) -> Tensor:
        """A first guess at the controls `(batch, control)` from features `(batch, feature)`; it may exceed the limits."""
        return self.rig[0].neutral_controls + features @ self.derivative

    def forward(self, coordinates: Tensor) -> Tensor:
        """Mesh coordinates `(batch, coordinate)` to features `(batch, feature)`; 0 at the neutral mesh."""
        return self.change(self.rest, self._features(coordinates))

    def left(self, wanted: Tensor, found: Tensor) -> Tensor:
        """What is left `(batch, feature)` from the mesh that was found to the one that is wanted, both in mesh coordinates."""
        return self.change(self._features(found), self._features(wanted))

    def change(self, before: Tensor, after: Tensor) -> Tensor:
        return self.rig[0].feature_change(before, after) / self.scale

    def _features(self, coordinates: Tensor) -> Tensor:
        return self.rig[0].features(self.neutral + coordinates @ self.estimate)
