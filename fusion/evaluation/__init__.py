"""How good a fused flight is: errors against a truth, checks, and the verdict made of them.

May import `fusion.result`, `fusion.alignment` (for the check of the camera's time) and what lies below them. Begin
reading at `fusion.evaluation.errors` for errors, at `fusion.evaluation.checks` for the table of checks.
"""
