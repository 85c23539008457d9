"""The methods that an evaluation compares: ours, simpler ones, bounds, and ours without each of its parts.

All of them share one shell, one fill and one set of cuts.
"""

from __future__ import annotations

from training.evaluate.methods.ablations import (
    CAP_FACTOR,
    Independent,
    IndependentByNoise,
    Looped,
    LoopedWithoutSmoothing,
    UniformFill,
    WithoutRefinement,
    WithoutSmoothing,
    without_clipping,
    without_opacification,
)
from training.evaluate.methods.baselines import inpainting, oracle, physgaussian
from training.evaluate.methods.method import Method, with_pipeline
from training.pipeline import Pipeline

__all__ = ["METHODS"]

METHODS: dict[str, Method] = {
    "ours": Method("Ours", "The product, as fruitninja-train runs it.", with_pipeline(Pipeline)),
    "physgaussian": Method("PhysGaussian", "Every interior atom takes the nearest surface colour.", physgaussian),
    "inpainting": Method("2D inpainting", "The prior draws each cut by itself when it is made.", inpainting),
    "independent": Method("Independent labels", "A label per plane, no volume, no loop.", with_pipeline(Independent)),
    "independent_sds": Method(
        "Independent, SDS", "A label per plane by the paper's eq. 5.", with_pipeline(IndependentByNoise)
    ),
    "looped": Method(
        "Labels in a loop", "A label per plane, refined from the render: the paper's loop.", with_pipeline(Looped)
    ),
    "no_clipping": Method("No atomic clipping", f"A scale cap {CAP_FACTOR} times wider.", without_clipping),
    "no_opacity": Method("No opacification", "Opacities drawn evenly from 0 to 1.", without_opacification),
    "no_smoothing": Method(
        "No smoothing", "Atoms that no view shows keep their start.", with_pipeline(WithoutSmoothing)
    ),
    "looped_no_smoothing": Method(
        "Loop, no smoothing", "The loop without smoothing.", with_pipeline(LoopedWithoutSmoothing)
    ),
    "no_refinement": Method("No refinement", "Labels stay what they were.", with_pipeline(WithoutRefinement)),
    "uniform": Method("Uniform fill", "The finest atoms everywhere.", with_pipeline(UniformFill), competes=False),
    "oracle": Method("Oracle labels", "True slices as labels: the 3-D part alone.", oracle, competes=False),
}
