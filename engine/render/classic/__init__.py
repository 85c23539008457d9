"""The numba kernels of the classic renderer, one stage per file, in the order in which a frame runs through them:
`depth_order`, `splats`, `tiles`, `blend`. `records` holds what they pass on, `rasterizer` runs them, and
`engine.render.lanes` gives them vectors.

Each kernel runs on one core and releases the interpreter lock; `engine.threads.for_each` spreads the chunks over the
cores. The chunks never depend on the number of cores, so neither does the result. All kernels are generic in the float
type: float32 is what runs, float64 is what the gradient checks use.
"""
