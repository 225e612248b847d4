"""Lateral offset: a Gaussian sum over frames, motion parallax, accelerometer and velocity, and its smoother.

`updates` is the part that the engine calls, with propagation steps, velocities and frames. `gaussian_sum` has the
model with its equations, `kernels` and `mixture_kernels` its compiled steps, `parallax` the evidence of the walls'
motion, `smoother` the pass backwards in time. `cross_section` holds back frames that show the walls beyond a step in
the width, `speed_check` velocities that contradict the frames. `status` decides what is reported: known, coasting or
unknown, and jumps.
"""
