"""Contents of a log and what can be fused from it: the parts of `corridor inspect`.

May import `fusion.logs`, `fusion.flight` and `vision`. Begin reading at `fusion.inspection.sources`, which opens any
log or manifest; `fusion.inspection.log` describes it, and `fusion.inspection.text` puts the findings into words.
"""
