"""Settings in TOML files, of any pydantic model: read, checked, explained and written.

May import only `vision`; the packages that own a model (`fusion.estimator.config`, `fusion.simulate.config`,
`fusion.logs.manifest`) import this one. Begin reading at `fusion.settings.toml`; `fusion.settings.sentences` locates
pydantic's errors, `fusion.settings.unit_hints` suggests the unit that a name or value may have been meant in.
"""
