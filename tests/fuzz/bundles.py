"""Bundles and checkpoints that nobody trained: small, quick to write, and whole."""

from pathlib import Path

import torch

from riginv.inference.bundle import write_bundle
from riginv.networks.inverse import DirectInverse
from riginv.networks.surrogate import ControlMLP
from riginv.rig.mesh_space import MeshSpace, RigInMeshSpace
from riginv.training.checkpoints import AtomicCheckpoints
from tests.support.toys import ToyRig

NETWORK = {"_target_": "riginv.networks.inverse.DirectInverse", "hidden": [8], "control_map": "neutral_start"}
TRAINING = {"steps": 1, "seconds": 0.5, "seed": 0}


def write_tiny_bundle(folder: Path) -> Path:
    """An inverse of the small toy with the weights that a network starts with."""
    rig = ToyRig(detail=1, arkit=True)
    space = RigInMeshSpace(rig, MeshSpace.from_rig(rig))
    torch.manual_seed(0)
    network = DirectInverse(space, hidden=[8], control_map="neutral_start")
    config = {"_target_": "tests.support.toys.ToyRig", "detail": 1, "arkit": True}
    write_bundle(folder, "inverse", network, space, NETWORK, config, TRAINING)
    return folder


def write_tiny_checkpoint(path: Path) -> Path:
    """What Lightning leaves of a training, in small."""
    layer = torch.nn.Linear(3, 2)
    optimizer = torch.optim.Adam(layer.parameters())
    layer(torch.ones(1, 3)).sum().backward()
    optimizer.step()
    loops = {"fit_loop": {"state_dict": {}, "epoch_progress": {"total": {"ready": 1, "completed": 0}}}}
    content = {"epoch": 0, "global_step": 1, "pytorch-lightning_version": "2.6.6", "state_dict": layer.state_dict()}
    content |= {"loops": loops, "callbacks": {"TrainingClock": {"seconds": 0.5}}}
    content |= {"optimizer_states": [optimizer.state_dict()], "lr_schedulers": [{"last_epoch": 1}]}
    AtomicCheckpoints().save_checkpoint(content, path)
    return path


def write_tiny_surrogate(folder: Path) -> Path:
    """A surrogate of the small toy that has learned nothing."""
    rig = ToyRig(detail=1, arkit=True)
    space = RigInMeshSpace(rig, MeshSpace.from_rig(rig))
    network = {"_target_": "riginv.networks.surrogate.ControlMLP", "hidden": [8]}
    config = {"_target_": "tests.support.toys.ToyRig", "detail": 1, "arkit": True}
    torch.manual_seed(0)
    write_bundle(folder, "forward", ControlMLP(rig, hidden=[8]), space, network, config, TRAINING)
    return folder
