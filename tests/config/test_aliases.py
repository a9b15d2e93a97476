"""Former names in configs: saved configs are upgraded, users are told the present names."""

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import OmegaConf

from riginv.config.aliases import ARGUMENTS, upgraded
from riginv.config.building import ClassSpec, class_of
from riginv.config.messages import CONFIGS
from riginv.errors import InputError
from riginv.sampling.meshes import MeshSampler

CORRELATED = {"_target_": "riginv.sampling.correlated.CorrelatedControls", "reach": 0.1, "spread": 0.5, "sparse": 0.5}
POSES, CONTROLS = "riginv.sampling.meshes.RigPoses", "riginv.sampling.controls"
SAVED_MIXTURE = {  # sampler=mixture as runs and stores saved it before names changed
    "samplers": {
        "random_combinations": {"_target_": "riginv.sampling.meshes.RandomCombinations"},
        "sparse_poses": {"_target_": POSES, "controls": {"_target_": f"{CONTROLS}.SparseControls", "most": None}},
        "plausible_poses": {
            "_target_": POSES,
            "controls": {"_target_": f"{CONTROLS}.PlausibleControls", "most": 40, "faint": 0.5},
        },
        "plausible_combinations": {"_target_": "riginv.sampling.meshes.PlausibleCombinations", "most": 60, "faint": 0.5},
        "correlated_poses": {"_target_": POSES, "controls": CORRELATED},
        "loose_poses": {"_target_": "riginv.sampling.loose.LoosePoses", "strength": 1.0, "controls": CORRELATED},
    },
    "_target_": "riginv.sampling.meshes.Mixture",
    "shares": {
        "random_combinations": 3,
        "sparse_poses": 3,
        "plausible_poses": 2,
        "plausible_combinations": 2,
        "correlated_poses": 3,
        "loose_poses": 8,
    },
}
BASELINES = {
    "blendshape_weights.BlendshapeWeights": "BlendshapeWeights",
    "clustered_gaussian_processes.ClusteredGaussianProcesses": "ClusteredGaussianProcesses",
    "coordinate_descent.CoordinateDescent": "CoordinateDescent",
    "gaussian_process.GaussianProcess": "GaussianProcess",
    "holden_gaussian_process.HoldenGaussianProcess": "HoldenGaussianProcess",
    "holden_network.HoldenNetwork": "HoldenNetwork",
    "majorisation.MajorisationMinimisation": "MajorisationMinimisation",
    "quadratic.QuadraticLevenbergMarquardt": "QuadraticLevenbergMarquardt",
    "tabulated.TabulatedGaussNewton": "TabulatedGaussNewton",
}
FORMER_CLASSES = {  # that configs could name at commit ecc3cdc -> the name of the class now
    "riginv.fitted_rig.FittedRig": "BlackBoxRig",
    "riginv.recorded_rig.RecordedRig": "RecordedRig",
    "riginv.losses.SquaredVertexLoss": "SquaredVertexLoss",
    "riginv.losses.VertexDistanceLoss": "RmsVertexDistanceLoss",
    "riginv.modules.forward.ForwardModule": "ForwardModule",
    "riginv.modules.holden.HoldenModule": "HoldenModule",
    "riginv.modules.inverse.InverseModule": "InverseModule",
    "riginv.sampling.loose.LoosePoses": "JointNoisePoses",
    **{f"riginv.sampling.controls.{name}": name for name in ("SparseControls", "PlausibleControls")},
    **{
        f"riginv.sampling.meshes.{name}": name
        for name in ("RigPoses", "Mixture", "RandomCombinations", "PlausibleCombinations")
    },
    "riginv.sampling.correlated.CorrelatedControls": "CorrelatedControls",
    **{f"riginv.networks.inverse.{name}": name for name in ("DirectInverse", "StagedInverse")},
    **{f"riginv.networks.ablations.{name}": name for name in ("NormalisedInverse", "UnboundedInverse", "UnboundedSurrogate")},
    "riginv.networks.surrogate.ControlMLP": "ControlMLP",
    "riginv.networks.local.LocalSurrogate": "LocalSurrogate",
    "riginv.networks.differential_subspace.DifferentialSubspace": "DifferentialSubspace",
    **{f"riginv.methods.solvers.{name}": name for name in ("LevenbergMarquardt", "Refined", "Clip")},
    "riginv.methods.neutral.Neutral": "Neutral",
    "riginv.methods.direct.Direct": "Direct",
    "riginv.methods.network.Network": "Network",
    **{f"riginv.baselines.{path}": name for path, name in BASELINES.items()},
    "rigs.face.FaceRig": "FaceRig",
    "rigs.body.BodyRig": "BodyRig",
    "rigs.shapes.ShapesRig": "ShapesRig",
    "rigs.pairs.PairsRig": "PairsRig",
    "rigs.gltf.GltfRig": "GltfRig",
    "rigs.surrogate.SurrogateRig": "SurrogateRig",
    "rigs.blender.rig.BlenderRig": "BlenderRig",
}


@pytest.mark.parametrize("former", FORMER_CLASSES)
def test_former_classes_are_found(former):
    assert class_of(former).__name__ == FORMER_CLASSES[former]


def test_every_renamed_argument_is_one_of_its_class():
    for target, names in ARGUMENTS.items():
        for former, present in names.items():
            ClassSpec.read({"_target_": target, present: 1 if present != "fractions" else {}})
            with pytest.raises(InputError, match=rf"{former} is named .*{present} now"):
                ClassSpec.read({"_target_": target, former: 1}, key="sampler")


def test_a_saved_mixture_is_the_present_default():
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(CONFIGS), version_base="1.3"):
        present = OmegaConf.to_container(compose("train", ["rig=face", "sampler=mixture"]).sampler, resolve=True)
    noise, fractions = present["samplers"]["joint_noise_poses"], present["fractions"]
    assert (noise["strength"], fractions["joint_noise_poses"]) == (2.0, 16)  # twice as much as was saved
    noise["strength"], fractions["joint_noise_poses"] = 1.0, 8
    assert upgraded(SAVED_MIXTURE) == present
    assert upgraded(present) == present
    assert list(upgraded(SAVED_MIXTURE)["samplers"]) == list(present["samplers"])  # equal draws
    ClassSpec.read(upgraded(SAVED_MIXTURE), MeshSampler)


def test_a_saved_run_has_present_keys():
    network = {"_target_": "riginv.networks.inverse.StagedInverse", "corrections": 2}
    saved = {"judging": {"test_poses": 5}, "model": {"network": network}, "turns": 3}
    present = {"_target_": "riginv.networks.inverse.StagedInverse", "refinement_steps": 2}
    assert upgraded(saved) == {"evaluation": {"test_poses": 5}, "model": {"network": present}, "iterations": 3}


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["sampler=loose_poses"], "sampler=loose_poses is named sampler=joint_noise_poses now"),
        (
            ["sampler=plausible_poses", "sampler.controls.faint=0.1"],
            "sampler.controls.faint is named sampler.controls.weak_fraction now",
        ),
        (
            ["sampler=sparse_poses", "+sampler.controls.most=3"],
            "sampler.controls.most is named sampler.controls.max_active now",
        ),
        (["judging.test_poses=20"], "judging.test_poses is named evaluation.test_poses now"),
        (["model.network.corrections=2"], "model.network.corrections is named model.network.refinement_steps now"),
        (["sampler.shares.loose_poses=0"], "sampler.shares.loose_poses is named sampler.fractions.joint_noise_poses now"),
    ],
)
def test_users_are_told_present_names(run, arguments, sentence):
    outcome = run("train", *arguments)
    assert outcome.code == 1 and sentence in outcome.text and "Traceback" not in outcome.text
    assert not outcome.folder.exists()
