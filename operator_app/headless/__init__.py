"""`sarcal run` and plain mode: sessions without a full screen."""
