"""``flight.toml``: streams of one flight that lie in different files, put together.

Begin reading at `fusion.logs.manifest.manifest`, what it may say; `fusion.logs.manifest.file` reads and writes it,
`fusion.logs.manifest.opening` opens what it names, `fusion.logs.manifest.sources` resolves that to streams, and
`fusion.logs.manifest.assembly` makes a flight of them or refuses it: `corridor inspect` and `corridor fuse` both ask
it.
"""
