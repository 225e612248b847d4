"""What a log holds and what can be made of it: the parts of `corridor inspect`.

`fusion.inspection.sources.inspect_path` opens and describes any log or manifest, `fusion.inspection.log.inspect_log`
one that is open; `fusion.inspection.text` puts the findings into words.
"""
