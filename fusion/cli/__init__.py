"""The command `corridor`: one file per verb, with its help and its text.

May import every other package of `fusion`; nothing imports it. Begin reading at `fusion.cli.app`.
"""
