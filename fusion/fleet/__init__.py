"""Many flights into one table: what ``corridor batch`` does.

A flight goes this way: `fusion.fleet.discovery` finds it, `fusion.fleet.batch` sees whether it has to be done,
`fusion.fleet.workers` hands it to a process (of this machine or of a Dask cluster), `fusion.fleet.worker` fuses it
there as ``corridor fuse`` does and makes its `fusion.fleet.row.FleetRow`, `fusion.fleet.journal` keeps the row, and
`fusion.fleet.tables` and `fusion.fleet.page` write all rows for people and programs. May import `fusion.outputs` and
what lies below it. Begin reading at `fusion.fleet.batch`.
"""
