"""Logs of autopilots: PX4 ULog, ArduPilot DataFlash, MAVLink telemetry.

Each format says where the columns of a message are; what is made of them is the same for all and stands in
`fusion.logs.autopilot.table`, where to begin reading. The modules named ``*_parse`` find messages in a log's bytes.
"""
