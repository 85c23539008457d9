"""The numba kernels of the classic renderer, one stage a file, in the order in which a frame runs through them:
`depth_order`, `splats`, `tiles`, `blend`. `rasterizer` puts them together; `engine.render.lanes` gives them vectors.

The kernels run on one core each and leave the interpreter free; `engine.threads.for_each` spreads their chunks over
the cores. How the work is cut into chunks never depends on the number of cores, so neither does the result. All are
generic in the float type: float32 is what runs, float64 is what the gradient checks use.
"""
