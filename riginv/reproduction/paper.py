"""What the paper reports: Marquis Bolduc and Phan, SIGGRAPH Asia 2022 Technical Communications, Tables 1 to 3."""

from riginv.reproduction.sets import CAPTURED, COMBINATIONS

TITLE = "Rig Inversion by Training a Differentiable Rig Function"
RIG = "its face: 137 controls, 628 weights, 8,447 vertices, judged by Maya; its own capture data"

# Mean and maximum vertex error, mm.
TABLE_1 = {"programmatic": (0.22, 1.4), "trained": (0.78, 5.9)}
TABLE_2 = {
    COMBINATIONS: {"inverse": (2.5, 15.0), "trained": (3.0, 17.2), "holden": (9.2, 100.0)},
    CAPTURED: {"inverse": (4.8, 49.0), "trained": (4.9, 49.1), "holden": (10.0, 99.0)},
}
# Roughness: mean squared second difference of the controls.
TABLE_3 = {"inverse": 3.8e-3, "trained": 3.4e-3, "direct": 2.3e-2, "direct_trained": 2.7e-2}
