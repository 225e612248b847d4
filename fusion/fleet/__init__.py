"""Fuse many flights into one table, for ``corridor batch``.

The steps for a flight: `fusion.fleet.discovery` finds it, `fusion.fleet.batch` checks whether it must be fused,
`fusion.fleet.workers` passes it to a process (local or of a Dask cluster), `fusion.fleet.worker` fuses it there as
``corridor fuse`` does and makes its `fusion.fleet.row.FleetRow`, `fusion.fleet.journal` stores the row, and
`fusion.fleet.tables` and `fusion.fleet.page` write all rows. May import `fusion.outputs` and
the packages below it. Begin reading at `fusion.fleet.batch`.
"""
