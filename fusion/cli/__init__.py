"""The command `corridor`: one file per command, with its help.

``X.py`` is the command ``corridor X``: its help, its options, and the few calls that it consists of. ``X_text.py``
lays out what it prints, ``X_options.py`` turns its options into a value. Where a package needs the same words
elsewhere (`fusion.alignment.text` in a manifest's comments, `fusion.inspection.text` as JSON), the text stays there.
Heavy modules load inside the commands. May import every other package; nothing imports it. Begin reading at
`fusion.cli.app`.
"""
