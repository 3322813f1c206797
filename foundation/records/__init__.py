"""Binary logs of fixed-size records, which a process appends to while it runs.

Import `record_log`. The layouts of the records are left to the packages that write them.
"""
