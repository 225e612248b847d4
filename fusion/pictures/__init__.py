"""Measure pictures without a flight: what `corridor measure` does.

Begin reading at `fusion.pictures.measure`.
"""
