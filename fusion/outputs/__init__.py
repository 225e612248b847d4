"""Write results: the output folder, and exports to Parquet, TUM and MCAP.

Begin reading at `fusion.outputs.folder`.
"""
