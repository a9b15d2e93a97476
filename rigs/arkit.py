"""ARKit's blendshape names under the module's former name; their home is `riginv.rig.arkit`."""

from riginv.rig.arkit import ARKIT_NAMES

__all__ = ["ARKIT_NAMES"]
