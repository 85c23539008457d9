"""The numba kernels of the classic renderer, one stage a file, in the order in which a frame runs through them:
`depth_order`, `splats`, `tiles`, `blend`. `records` holds what they pass on, `rasterizer` runs them, and
`engine.render.lanes` gives them vectors.

The kernels run on one core each and release the interpreter lock; `engine.threads.for_each` spreads their chunks over
the cores. The chunks never depend on the number of cores, so neither does the result. All are
generic in the float type: float32 is what runs, float64 is what the gradient checks use.
"""
