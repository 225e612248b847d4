"""CSV files: those of an ASL flight folder, and tables of any form.

Begin reading at `fusion.logs.csv.rows`, which all readers of tables share, including those of other packages.
`fusion.logs.csv.stamped_table` reads ``timestamp, numbers ...``; `fusion.logs.csv.columns` is the log format, for
which `fusion.logs.csv.table` detects a file's layout, `fusion.logs.csv.column_names` the meaning of its columns
and `fusion.logs.csv.times` when its rows were taken.
"""
