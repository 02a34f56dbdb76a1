"""The control loop of an arm on CANopen: SYNC, commands, STOP, connection."""
