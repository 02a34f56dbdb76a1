"""What a person or a script sees: command line, session, terminal app, files."""
