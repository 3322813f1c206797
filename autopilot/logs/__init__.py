"""Logs of a vehicle: fixed-size records for the run's tables, and PX4's ULog.

Import `vehicle_record` for the layout of a row, `ulog_file` for the log that ground stations download.
"""
