"""`sarcal run` and plain mode: sessions without the terminal app."""
