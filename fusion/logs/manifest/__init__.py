"""``flight.toml``: one flight assembled from streams in different files.

Begin reading at `fusion.logs.manifest.manifest`, its contents; `fusion.logs.manifest.file` reads and writes it,
`fusion.logs.manifest.opening` opens its files, `fusion.logs.manifest.sources` resolves them to streams, and
`fusion.logs.manifest.assembly` makes a flight of them or rejects it, for both `corridor inspect` and `corridor fuse`.
"""
