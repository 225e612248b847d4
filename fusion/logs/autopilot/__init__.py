"""Logs of autopilots: PX4 ULog, ArduPilot DataFlash, MAVLink telemetry. One reader per format."""
