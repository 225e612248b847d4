"""How good a fused flight is: errors against a truth, checks, and the verdict made of them.

Imports `fusion.result` and what lies below it. Begin reading at `fusion.evaluation.errors`; checks are in `checks`.
"""
