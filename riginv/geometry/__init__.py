"""Pure batched functions of rig logic: driven-key curves, combinations, forward kinematics, skinning."""
