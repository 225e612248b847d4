"""``flight.toml``: streams of one flight that lie in different files, put together.

Begin reading at `fusion.logs.manifest.manifest`.
"""
