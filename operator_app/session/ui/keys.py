"""The keys that work before anything else is loaded. Knows nothing, imports nothing."""

STOP_KEYS = ("space", "f8")
QUIT_KEYS = ("q", "ctrl+q", "ctrl+c")
