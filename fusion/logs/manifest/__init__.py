"""``flight.toml``: streams of one flight that lie in different files, put together.

Begin reading at `fusion.logs.manifest.manifest`, the file itself; `fusion.logs.manifest.sources` resolves it to
streams, for `corridor inspect` and `corridor fuse` alike, and `fusion.logs.manifest.assembly` makes a flight of them.
"""
