"""CSV files of any shape: the tables, their columns, their times.

Begin reading at `fusion.logs.csv.columns`.
"""
