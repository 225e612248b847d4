"""The command `corridor`: one file per command, with its help.

``X.py`` is the command ``corridor X``: its help, its options, and its few calls. ``X_text.py``
formats its output, ``X_options.py`` converts its options to a value. If a package uses the same text elsewhere
(`fusion.alignment.text` in a manifest's comments, `fusion.inspection.text` as JSON), the text is in that package.
Heavy modules are imported inside the commands. May import every other package; nothing imports it. Begin reading at
`fusion.cli.app`.
"""
