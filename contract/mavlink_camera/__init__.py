"""A MAVLink camera component that answers clicks: its commands, messages and clicks, for both sides.

No link. pymavlink's dialect is handed in by whoever has it, so that nothing here imports it.
"""
