"""The estimator on a vehicle: a camera and MAVLink in, estimates out, everything recorded.

`fusion.live.core` is the whole computation, a state machine without clock, thread or socket: packets, frames and
ticks in, packets out. `fusion.live.session` runs it beside a camera (`fusion.live.cameras`) and a link
(`fusion.live.link`); `fusion.live.recording` writes all inputs and outputs, in order, and `fusion.live.replay` runs
the same machine over that file, which gives the same packets. Begin reading at `fusion.live.core`.
"""
