"""Avatars in glTF and GLB (VRM too) as rigs."""

from rigs.gltf.rig import GltfRig

__all__ = ["GltfRig"]
