"""Write results: the output folder, and exports to Parquet, TUM and MCAP.

May import `fusion.report`, `fusion.result` and the packages below them. Begin reading at `fusion.outputs.folder`;
each export is a separate module, whose library is loaded when it is used.
"""
