"""Quality of a fused flight: errors against ground truth, checks, and the verdict.

May import `fusion.result`, `fusion.alignment` (for the check of the camera's time) and the packages below them. Begin
reading at `fusion.evaluation.errors` for errors, at `fusion.evaluation.checks` for the table of checks.
"""
