"""What both user interfaces share: actions, guards, snapshot, runner."""
