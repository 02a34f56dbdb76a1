"""Parts that all user interfaces share: actions, guards, snapshot, runner."""
