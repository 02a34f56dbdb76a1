"""One module a command: its options and what it does. They share sessions, reports and exit codes."""
