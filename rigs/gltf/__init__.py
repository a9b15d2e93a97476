"""glTF avatars (.glb, .gltf, .vrm) as rigs."""

from rigs.gltf.rig import GltfRig as GltfRig
