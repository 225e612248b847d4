"""Logs of autopilots: PX4 ULog, ArduPilot DataFlash, MAVLink telemetry.

Each format module finds the columns of the messages; their conversion is common to all formats. Begin reading at
`fusion.logs.autopilot.table`. The modules named ``*_parse`` find messages in a log's bytes.
"""
