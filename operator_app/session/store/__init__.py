"""A session's state and its journal on disk: events, replay, repair, the stored calibration."""
