"""Settings in TOML files, of any pydantic model: read, checked, explained and written.

May import only `vision`; the packages that own a model (`fusion.estimator.config`, `fusion.simulate.config`,
`fusion.logs.manifest`) import this one. Begin reading at `fusion.settings.toml`; `fusion.settings.sentences` locates
what pydantic finds wrong, `fusion.settings.unit_hints` knows which unit a name or a value may have been meant in.
"""
